"""Routes followed backwards: which numbers a packet needs for its inputs to get wanted ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..drive.route import Array, Origin, Route

_DEPENDENT = 1e-9  # share of a row that is new, below which it says nothing new


class RouteInverse:
    """Solves routes for the numbers of the events that they take.

    What is left open is as small as possible. Where routes ask for things that cannot both be,
    the first ones get what they want, number by number.

    Args:
        routes: the most important first; each takes something from an event.
    """

    def __init__(self, routes: Sequence[Route]) -> None:
        self._routes = list(routes)
        self._columns: dict[Origin, dict[int, int]] = {}
        width = 0
        for route in routes:
            for term in route.value.terms:
                known = self._columns.setdefault(term.origin, {})
                for number in term.take.tolist() if term.origin.is_event else ():
                    if number not in known:
                        known[number] = width
                        width += 1
        rows = np.concatenate([self._rows(route, width) for route in routes])
        self._kept = _independent(rows)
        self._inverse = np.linalg.pinv(rows[self._kept])
        # Of each origin: which of its numbers are taken, and where they are in the solution.
        self._taken = {
            origin: (np.array(list(columns), np.intp), np.array(list(columns.values()), np.intp))
            for origin, columns in self._columns.items()
        }

    @property
    def origins(self) -> list[Origin]:
        """The events whose numbers the routes take."""
        return [origin for origin in self._columns if origin.is_event]

    def _rows(self, route: Route, width: int) -> Array:
        """What each number of a route takes of each number of the events, (n, width)."""
        rows = np.zeros((len(route.value.offset), width))
        for term in route.value.terms:
            if term.origin.is_event:
                columns = [self._columns[term.origin][number] for number in term.take.tolist()]
                rows[term.at, columns] += term.times
        return rows

    def solve(
        self, wanted: Mapping[str, Array], output: Callable[[Origin], Array]
    ) -> Callable[[Origin, int], Array]:
        """Solves for one packet.

        Args:
            wanted: what the input of each route is to get, (n,), by `name.key`.
            output: the numbers of an output that routes read beside events.

        Returns:
            a function that gives the numbers of an event, of which there are so many, (n,);
            zero where nothing is asked for.
        """

        def known(origin: Origin) -> Array:
            if not origin.is_event:
                return output(origin)
            return np.zeros(max(self._columns[origin], default=0) + 1)

        asked = [wanted[r.to.target] - r.value.evaluate(known) for r in self._routes]
        solution = self._inverse @ np.concatenate(asked)[self._kept]

        def numbers(origin: Origin, count: int) -> Array:
            found = np.zeros(count)
            if origin in self._taken:
                taken, columns = self._taken[origin]
                found[taken] = solution[columns]
            return found

        return numbers


def _independent(rows: Array) -> list[int]:
    """Indices of the rows that are no sum of multiples of those before them."""
    basis = np.empty((0, rows.shape[1]))
    kept = []
    for i, row in enumerate(rows):
        size = np.linalg.norm(row)
        rest = row - basis.T @ (basis @ row)
        rest -= basis.T @ (basis @ rest)  # once more, for what rounding has left
        if size > 0 and np.linalg.norm(rest) > _DEPENDENT * size:
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
            kept.append(i)
    return kept
