"""The rendered parts of the documentation's pages, filled from results of real runs:
`python -m docs.build`.
"""
