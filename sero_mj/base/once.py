"""Filter for texts that are reported only once."""

from __future__ import annotations

_MAX_TEXTS = 100


class Once:
    """A filter for texts such as warnings, which are to be reported only once."""

    def __init__(self) -> None:
        self._texts: set[str] = set()

    def __call__(self, text: str) -> bool:
        """Returns whether a text is new. After a hundred different texts, returns False."""
        is_new = text not in self._texts and len(self._texts) < _MAX_TEXTS
        if is_new:
            self._texts.add(text)
        return is_new
