"""What happens in a scenario from a time on, and perhaps until another."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from ..declaration import Declaration


class Timed(Declaration):
    """Something that begins and may end.

    Attributes:
        begin: s.
        end: s; None for never.
    """

    begin: float = Field(0.0, ge=0)
    end: float | None = None

    @model_validator(mode="after")
    def _ends_later(self) -> Self:
        if self.end is not None and self.end <= self.begin:
            raise ValueError(f"end: found {self.end:g}; expected more than begin, {self.begin:g} s")
        return self
