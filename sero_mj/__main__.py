"""`python -m sero_mj` and the `sero-mj` command."""

from .cli import main

if __name__ == "__main__":
    main()
