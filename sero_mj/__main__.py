"""`python -m sero_mj` and the `sero-mj` command."""

import gc
import signal
import sys

_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]

# Loading makes no garbage, but many objects, which the collector would look at again and again.
_FEW_COLLECTIONS = 50_000


def main() -> None:
    """Runs the command line; ends quietly on Ctrl+C, also while it is still being loaded.

    It ends likewise, and leaves no half-written files, by `kill` and when its terminal is closed.
    """
    gc.set_threshold(_FEW_COLLECTIONS)
    for ending in _ENDING:
        if signal.getsignal(ending) == signal.SIG_DFL:  # not with nohup
            signal.signal(ending, signal.default_int_handler)
    try:
        from .cli import main as run

        run()
    except KeyboardInterrupt:
        print("sero-mj: interrupted", file=sys.stderr)
        sys.exit(130)
    finally:
        gc.freeze()  # nor is all of it looked at when the process ends


if __name__ == "__main__":
    main()
