"""What `vstestbed new` writes: one file for each kind, which runs as it is; `my_law` and `MyLaw`
become the name that is asked for.
"""
