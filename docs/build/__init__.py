"""The pages of the documentation, made from their sources and from real runs:
`python -m docs.build`.
"""
