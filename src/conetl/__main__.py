"""`python -m conetl`: the command line."""

from conetl.cli import main

if __name__ == "__main__":
    main()
