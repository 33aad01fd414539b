"""`python -m surrofe2` is the command line."""

from surrofe2.cli import main

main()
