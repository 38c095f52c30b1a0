"""`Once`: reports each text once."""

from __future__ import annotations

_MOST = 100  # different texts


class Once:
    """Remembers the texts that were reported."""

    def __init__(self) -> None:
        self._texts: set[str] = set()

    def __call__(self, text: str) -> bool:
        """Returns whether a text is to be reported: it is new, and one of the first hundred."""
        is_new = text not in self._texts and len(self._texts) < _MOST
        if is_new:
            self._texts.add(text)
        return is_new
