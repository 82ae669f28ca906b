"""`python -m vstestbed` is the command line."""

from vstestbed.cli import main

main()
