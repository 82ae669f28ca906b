"""`python -m vstestbed` is the command line."""

from vstestbed.cli.app import main

main()
