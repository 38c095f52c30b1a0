"""`Once`: reports each text once."""

from __future__ import annotations

_MAX_TEXTS = 100


class Once:
    """Stores the texts that were reported."""

    def __init__(self) -> None:
        self._texts: set[str] = set()

    def __call__(self, text: str) -> bool:
        """Returns whether to report a text: it is new and one of the first hundred texts."""
        is_new = text not in self._texts and len(self._texts) < _MAX_TEXTS
        if is_new:
            self._texts.add(text)
        return is_new
