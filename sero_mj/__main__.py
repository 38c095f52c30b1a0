"""`python -m sero_mj` and the `sero-mj` command."""

import sys


def main() -> None:
    """Runs the command line; ends quietly on Ctrl+C, also while it is still being loaded."""
    try:
        from .cli import main as run

        run()
    except KeyboardInterrupt:
        print("sero-mj: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
