"""`python -m sero_mj` and the `sero-mj` command."""

import gc
import signal
import sys

_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]

# Imports create many objects and no garbage. With the default threshold and without `gc.freeze`,
# rendering one image takes 6 % more CPU time.
_GC_THRESHOLD = 50_000


def main() -> None:
    """Runs the command line; Ctrl+C ends it without a traceback, also during imports.

    SIGTERM and a closed terminal have the same effect, so that no files remain half-written.
    """
    gc.set_threshold(_GC_THRESHOLD)
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
        gc.freeze()  # skips a collection at exit


if __name__ == "__main__":
    main()
