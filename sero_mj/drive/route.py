"""Routes: what of which source, robot or frame goes to which input.

route  = target "=" origin
target = name "." input          lwr.joint_angles, contact.vector, toggles.legend
origin = ["not"] expression      udp.values0, udp.values0[0:7] * deg, leader.torques - lwr.torques;
                                 `not` negates a toggle
       | frame                   lwr/flange: its pose in the world
       | robot ".fwd_kin_base_to_flange"  likewise in the robot's base

`_syntax` has the grammar of expressions, `_expression` their meaning.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..assemble.inputs import ROBOT_INPUTS, SCENE, Input, list_inputs
from ..assemble.named_frames import WORLD
from ..assemble.route_text import NOT, names_in
from ..assemble.scene import Scene
from ..errors import DeclarationError, Problem, RouteError, did_you_mean, nearest
from ..receive.source import Source, make_source
from ._expression import Value, evaluate
from ._names import Names
from ._syntax import Expression, parse
from ._units import Exponents, describe, dimension_of
from .wiring import FrameRoute, Route, Wiring, allow_blanks, levels_of_frames, routes_in_order


def wire(scene: Scene) -> Wiring:
    """Builds the scene's sources and checks its routes, without opening anything.

    Routes to robots and sources that are themselves declared wrongly are left unchecked: one
    report of one mistake is enough.
    """
    wiring = Wiring()
    for name, declared in scene.sources.items():
        try:
            wiring.sources[name] = make_source(name, declared)
        except DeclarationError as error:
            wiring.problems += [p.inside(f"sources.{name}") for p in error.problems]
    wiring.problems += _shared_places(wiring.sources)
    inputs = list_inputs(scene)
    names = Names(scene, wiring.sources, inputs)
    for target, origin in scene.routes.items():
        try:
            item = _input(scene, inputs, target)
            route = _route(scene, names, item, target, origin)
        except DeclarationError as error:
            wiring.problems += [p.inside(f"routes.{target}") for p in error.problems]
            continue
        if isinstance(route, Route):
            wiring.routes.append(route)
        elif route is not None:
            wiring.frame_routes.append(route)
    allow_blanks(wiring)
    try:
        wiring.later = routes_in_order(wiring.routes)
    except DeclarationError as error:
        wiring.problems += error.problems
    try:
        wiring.levels = levels_of_frames(scene, wiring.frame_routes)
    except DeclarationError as error:
        wiring.problems += error.problems
    return wiring


def _shared_places(sources: Mapping[str, Source]) -> list[Problem]:
    """Ports that two sources of one scene would listen on."""
    problems = []
    taken: dict[tuple[str, int], str] = {}
    for name, source in sources.items():
        place = getattr(source, "place", None)
        if place is None or place[1] == 0:  # no port, or one that the system chooses
            continue
        if place in taken:
            message = f"{place[1]} on {place[0]} is the port of source '{taken[place]}' already"
            problems.append(Problem(f"sources.{name}.port", message))
        taken.setdefault(place, name)
    return problems


def _input(scene: Scene, inputs: Mapping[str, Input], target: str) -> Input | Problem | None:
    """The input that a route leads to, what is wrong with it, or None where that is known."""
    if target in inputs:
        return inputs[target]
    name, _, key = target.partition(".")
    keys = [item.key for item in inputs.values() if item.name == name]
    if scene.is_broken(name):
        near = nearest(key, ROBOT_INPUTS)  # one of its own inputs may be meant
        mistyped = near is not None and f"robots.{name}" in scene.broken and key not in ROBOT_INPUTS
        return (
            Problem("", f"no input '{key}' of {name}; did you mean '{near}'?") if mistyped else None
        )
    double = scene.doubles.get(name)
    if double is not None and double.path is not None and key != "visible":
        return Problem("", f"'{name}' shows a path; nothing can be routed to it")
    if keys and (double is None or double.of in scene.robots):
        return Problem("", f"no input '{key}' of {name}{did_you_mean(key, keys)}")
    if double is not None:
        return None
    names = [item.name for item in inputs.values() if item.name != SCENE]
    near = did_you_mean(name, dict.fromkeys([*scene.declared("robots"), *names]))
    return Problem("", f"no robot '{name}'{near}")


def _route(
    scene: Scene, names: Names, item: Input | Problem | None, target: str, origin: str
) -> Route | FrameRoute | None:
    """A checked route, or None where what is wrong with it is known already."""
    problems = [item] if isinstance(item, Problem) else []
    try:
        expression = parse(origin)
    except RouteError as error:
        raise DeclarationError([*problems, Problem("", str(error))]) from None
    if isinstance(item, Input) and expression.negated and item.kind != "toggle":
        problems.append(Problem("", f"'{NOT}' is for switches; {target} takes {item.meaning}"))
    name = expression.name
    if name is not None and (names.is_frame(name) or names.is_fwd_kin(name)):
        route = _frame_route(scene, names, problems, item, name)
        if problems:
            raise DeclarationError(problems)
        return route
    found = {name: names.find(name) for name in names_in(origin)}
    problems += [value for value in found.values() if isinstance(value, Problem)]
    if problems:
        raise DeclarationError(problems)
    known = {name: value for name, value in found.items() if isinstance(value, Value)}
    if len(known) < len(found) or not isinstance(item, Input):
        return None  # its own declaration is wrong and already reported
    return _number_route(scene, item, expression, known)


def _number_route(
    scene: Scene, item: Input, expression: Expression, names: Mapping[str, Value]
) -> Route:
    text = expression.text.strip()
    text = text.removeprefix(NOT).lstrip() if expression.negated else text
    try:
        value = evaluate(expression, names)
    except RouteError as error:
        raise DeclarationError([Problem("", str(error))]) from None
    message = _misfit(value, text, item, dimension_of(scene, item))
    if message:
        raise DeclarationError([Problem("", message)])
    return Route(item, text, value.compile(item.count), expression.negated)


def _misfit(value: Value, text: str, item: Input, taken: Exponents) -> str:
    """Says why a value does not fit an input; empty when it does.

    Args:
        value: what the route computes.
        text: its expression.
        item: the input.
        taken: the exponents of the input's units, (count, 4); zero takes any.
    """
    return _wrong_shape(value, text, item) or _wrong_unit(value, text, item, taken)


def _wrong_shape(value: Value, text: str, item: Input) -> str:
    count, shape = value.offset.size, value.shape
    many = "1 value" if count == 1 else f"{count} values"
    if item.shape == (4, 4):
        if value.is_frames and count == 16:
            return ""
        found = f"has {many}" if len(shape) < 2 else f"is {' x '.join(map(str, shape))}"
        return f"{text} {found}; {item.target} takes {item.meaning}: 1M in the structure"
    if value.is_constant and not shape:
        return ""  # one number for all
    if count != item.count:
        return f"{text} has {many}; {item.target} takes {item.meaning}"
    if value.is_frames:
        return f"{text} is a 4 x 4 frame; {item.target} takes {item.meaning}"
    return ""


def _wrong_unit(value: Value, text: str, item: Input, taken: Exponents) -> str:
    found = value.dimensions.reshape(-1, 4)
    for i, want in enumerate(taken):
        have = found[i if len(found) > 1 else 0]
        if have.any() and want.any() and (have != want).any():
            where = ""
            if (found != found[0]).any() or (taken != taken[0]).any():
                where = f" at number {i}, counted from 0"
            return f"{text} is {describe(have)}; {item.target} takes {describe(want)}{where}"
    return ""


def _frame_route(
    scene: Scene, names: Names, problems: list[Problem], item: Input | Problem | None, text: str
) -> FrameRoute | None:
    is_fwd_kin = names.is_fwd_kin(text)
    if not is_fwd_kin and text not in scene.named_frames():
        if scene.is_broken(text.partition("/")[0]):
            return None
        problems.append(Problem("", f"no frame '{text}'{names.frame_hint(text)}"))
        return None
    if not isinstance(item, Input):
        return None
    received = scene.frames.get(item.name)
    if received is not None and received.relative_to != WORLD and not is_fwd_kin:
        message = f"{text} is a pose in the world; set relative_to of {received.name} to 'world'"
        problems.append(Problem("", message))
    if item.shape != (4, 4):
        message = f"{text} is a 4 x 4 frame; {item.target} takes {item.meaning}"
        problems.append(Problem("", message))
    return FrameRoute(item, text.partition(".")[0] if is_fwd_kin else text, is_fwd_kin)
