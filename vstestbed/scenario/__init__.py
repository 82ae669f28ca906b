"""One experiment as a frozen object: its YAML, its checks, every mistake with its place in the
file.
"""
