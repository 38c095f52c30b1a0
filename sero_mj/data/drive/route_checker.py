"""`RouteChecker`: finds the targets and origins of routes, and reports their errors.

If a route is invalid only because of an error that another check reports, for example an invalid
robot, the raised `DeclarationError` has no problems.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...base.errors import (
    DeclarationError,
    Problem,
    RouteError,
    UnknownName,
    collect,
    did_you_mean,
    nearest,
    problems_of,
)
from ...robots.declared.cartesian import WORLD
from ...robots.declared.couplings import CoupledJoints
from ...robots.declared.inputs import (
    PLANAR,
    POSE_NUMBERS,
    ROBOT_INPUTS,
    SCENE,
    Input,
    inputs_of_group,
    list_inputs,
)
from ...robots.declared.route_text import NOT, names_in, parts_of_origin
from ...robots.declared.scene import Scene
from ..receive.source import SIGNALS, Source
from .evaluator import condition_of, evaluate
from .joint_routes import JointPart, joint_parts, named_joints, named_twice, places_by_name
from .language import Expression, parse
from .model_torques import MODEL_TORQUES, model_output, why_unknown
from .route import FrameRoute, Origin, Route
from .units import UNITS, units_of, wrong_unit
from .values import Value, constant, joined, numbers_of

FWD_KIN = "fwd_kin_base_to_flange"
# Kinds of inputs that routes can read: all except toggles and poses.
_READABLE = ("angles", "values", "vector")
AnyRoute = Route | FrameRoute | JointPart


class RouteChecker:
    """A checker that converts the routes of a scene to compiled routes."""

    def __init__(self, scene: Scene, sources: Mapping[str, Source]) -> None:
        self._scene, self._sources = scene, sources
        self._inputs = list_inputs(scene)
        self._frames = scene.named_frames()
        self._outputs = {key: item for key, item in self._inputs.items() if item.kind in _READABLE}
        self._owners = {item.name for item in self._outputs.values()}
        self._events: dict[Origin, Value] = {}  # cache, because an event may have 65,000 numbers

    def check(self, target: str, origin: str) -> Sequence[AnyRoute]:
        """Returns the routes from an origin to a target; raises DeclarationError."""
        name, _, key = target.partition(".")
        limb, dot, of_limb = key.partition(".")
        dot = "" if f"{name}.{limb}" in self._inputs else dot  # lwr.torques.0 is not a limb
        parts = parts_of_origin(origin)
        if dot and parts[0][1] is not None:
            message = f"joint names are not allowed with the limb '{limb}'"
            raise Problem("", message, expected=f"a route to {name}.{of_limb}").error()
        if dot:
            return self._of_joints(name, of_limb, [(origin, [limb])])
        if parts[0][1] is not None:
            return self._of_joints(name, key, parts)
        problems: list[Problem] = []
        inputs: list[Input] = []
        routes: Sequence[AnyRoute] = []
        with collect(problems, ""):
            inputs = self._inputs_of(name, key)
        with collect(problems, ""):
            routes = self._whole(inputs, origin, target)
        if problems:
            raise DeclarationError(problems)
        return routes

    def _of_joints(
        self, name: str, key: str, parts: Sequence[tuple[str, list[str] | None]]
    ) -> list[AnyRoute]:
        scene, target = self._scene, f"{name}.{key}"
        inputs = self._inputs_of(name, key)
        if inputs[0].kind not in ("angles", "values"):
            message = f"joint names are only for inputs with a value per joint, but {target} takes"
            raise Problem("", f"{message} {inputs[0].meaning}").error()
        problems: list[Problem] = []
        places = places_by_name(scene, inputs, in_group=scene.members(name) is not None)
        joints = [named_joints(scene, name, places, names, problems) for _, names in parts]
        problems += named_twice(scene, [joint for each in joints for joint in each])
        made: list[AnyRoute] = []
        for (origin, _), places_of_origin in zip(parts, joints, strict=True):
            with collect(problems, ""):
                expression = _parsed(origin)
                if expression.negated or expression.is_condition:
                    found = f"'{NOT}' is" if expression.negated else "comparisons are"
                    message = f"{found} only for toggles; joints take numbers"
                    raise Problem("", message).error()
                value = self._evaluated(expression)
                if not problems:
                    made += joint_parts(scene, *value, places_of_origin, target)
        if problems:
            raise DeclarationError(problems)
        return made

    def _whole(self, inputs: Sequence[Input], origin: str, target: str) -> Sequence[AnyRoute]:
        expression = _parsed(origin)
        problems: list[Problem] = []
        if inputs and expression.negated and inputs[0].kind != "toggle":
            message = f"'{NOT}' is only for toggles, but {target} takes {inputs[0].meaning}"
            problems.append(Problem("", message))
        routes: Sequence[AnyRoute] = []
        with collect(problems, ""):
            if expression.name is not None and self._is_frame(expression.name):
                routes = self._frame_route(inputs, expression.name)
            elif expression.is_condition:
                routes = self._toggles(inputs, expression, target)
            else:
                routes = self._numeric(inputs, expression, target)
        if problems:
            raise DeclarationError(problems)
        return routes

    def _numeric(self, inputs: Sequence[Input], expression: Expression, target: str) -> list[Route]:
        value, text = self._evaluated(expression)
        shares = [value] * len(inputs)
        if len(inputs) > 1 and inputs[0].kind in ("angles", "values"):
            shares = _shares(value, inputs, text, target)
        routes = []
        first = 0  # index of a share's first number
        for each, share in zip(inputs, shares, strict=True):
            item = self._as_numbers(each, share)
            full, numbers = share, np.arange(share.entries.size)
            if item.coupled is not None and share.shape and share.entries.size == item.coupled.k:
                full, numbers = _with_coupled(share, item, item.coupled), item.coupled.source
            units = units_of(self._scene, item)
            message = _wrong_shape(full, item) or wrong_unit(full.units, units, item.target)
            if message:
                raise Problem("", f"{text} {message}").error()
            numbers = np.broadcast_to(first + numbers, item.count)
            compiled = full.compile(item.count)
            routes.append(Route(item, text, compiled, expression.negated, tuple(numbers.tolist())))
            if share is not value:
                first += share.entries.size
        return routes

    def _as_numbers(self, item: Input, value: Value) -> Input:
        count, robot = value.entries.size, self._scene.robots.get(item.name)
        is_planar = robot is not None and robot.free_base == "planar" and item.kind == "pose"
        fits = count == len(POSE_NUMBERS) or (count == len(PLANAR) and is_planar)
        if not item.is_pose or value.is_frames or len(value.shape) != 1 or not fits:
            return item
        return replace(item, shape=(count,))

    def _toggles(self, inputs: Sequence[Input], expression: Expression, target: str) -> list[Route]:
        problems: list[Problem] = []
        if inputs and inputs[0].kind != "toggle":
            message = f"comparisons are only for toggles, but {target} takes {inputs[0].meaning}"
            problems.append(Problem("", message))
        with collect(problems, ""):
            names = self._known(expression)
        if problems:
            raise DeclarationError(problems)
        try:
            value, condition = condition_of(expression, names)
        except RouteError as error:
            raise Problem("", str(error)).error() from None
        compiled, text = value.compile(value.entries.size), expression.text.strip()
        return [Route(item, text, compiled, condition=condition) for item in inputs]

    def _frame_route(self, inputs: Sequence[Input], origin: str) -> list[FrameRoute]:
        is_fwd_kin, name = self._is_fwd_kin(origin), self._scene.frame_name(origin)
        if not is_fwd_kin and name not in self._frames:
            raise self._no_frame(origin)
        if not inputs:
            return []
        item, problems = inputs[0], []
        received = self._scene.frames.get(item.name)
        if received is not None and received.relative_to != WORLD and not is_fwd_kin:
            fix = f"set relative_to of {received.name} to 'world'"
            problems.append(Problem("", f"{origin} is a pose in the world; {fix}"))
        if item.shape != (4, 4):
            message = f"{origin} is a 4 x 4 frame, but {item.target} takes {item.meaning}"
            problems.append(Problem("", message))
        if problems:
            raise DeclarationError(problems)
        return [FrameRoute(item, name.partition(".")[0] if is_fwd_kin else name, is_fwd_kin)]

    def _evaluated(self, expression: Expression) -> tuple[Value, str]:
        known = self._known(expression)
        text = expression.text.strip()
        text = text.removeprefix(NOT).lstrip() if expression.negated else text
        try:
            return evaluate(expression, known), text
        except RouteError as error:
            raise Problem("", str(error)).error() from None

    def _known(self, expression: Expression) -> dict[str, Value]:
        names, problems = names_in(expression.text), list[Problem]()
        known: dict[str, Value] = {}
        for name in names:
            with collect(problems, ""):
                known[name] = self._find(name)
        if len(known) < len(names):
            raise DeclarationError(problems)
        return known

    def _inputs_of(self, name: str, key: str) -> list[Input]:
        members = self._scene.members(name)
        if members is None:
            return [self._input(f"{name}.{key}")]
        if any(each not in {*self._scene.robots, *self._scene.doubles} for each in members):
            raise DeclarationError([])  # reported elsewhere
        try:
            return list(inputs_of_group(self._inputs, name, key, members))
        except UnknownName as error:
            of, known = f"of {name}", error.available
            raise Problem("", "no input", found=key, of=of, available=known).error() from None
        except ValueError as error:
            raise DeclarationError([*problems_of(error)]) from None

    def _input(self, target: str) -> Input:
        if target in self._inputs:
            return self._inputs[target]
        scene, (name, _, key) = self._scene, target.partition(".")
        keys = [item.key for item in self._inputs.values() if item.name == name]
        if scene.is_broken(name) or scene.is_broken(name, ("groups",)):
            near = nearest(key, ROBOT_INPUTS)  # the robot may also declare this input
            mistyped = near is not None and key not in ROBOT_INPUTS
            message = f"no input '{key}' of {name}; did you mean '{near}'?"
            moves = {f"robots.{name}", f"groups.{name}"} & scene.broken
            raise DeclarationError([Problem("", message)] if mistyped and moves else [])
        double, robot = scene.doubles.get(name), scene.robots.get(name)
        message = ""
        if double is not None and double.path is not None and key != "visible":
            message = f"'{name}' shows a path, which has no inputs for routes"
        if robot is not None and robot.mount is not None and key == "base_frame":
            message = f"{name} is mounted on {robot.mount}, which moves its base"
            message += ". Remove this route, or the mount"
        if message:
            raise Problem("", message).error()
        if keys and (double is None or double.of in scene.robots):
            raise Problem("", "no input", found=key, of=f"of {name}", available=keys).error()
        if double is not None:
            raise DeclarationError([])
        names = [item.name for item in self._inputs.values() if item.name != SCENE]
        names += [*scene.declared("groups"), *scene.double_groups]
        known = dict.fromkeys([*scene.declared("robots"), *names])
        raise Problem("", "no robot", found=name, available=known).error()

    def _is_frame(self, name: str) -> bool:
        return "/" in name or name in self._frames or self._is_fwd_kin(name)

    def _is_fwd_kin(self, name: str) -> bool:
        robot, _, key = name.partition(".")
        return key == FWD_KIN and robot in self._scene.robots and robot not in self._scene.sources

    def _no_frame(self, name: str) -> DeclarationError:
        if self._scene.is_broken(name.partition("/")[0]):
            return DeclarationError([])
        events = [f"{n}.{event}" for n, source in self._sources.items() for event in source.events]
        spaces = _missing_spaces(name, [*UNITS, *self._outputs, *events])
        message = f"no frame '{name}'{spaces or did_you_mean(name, self._frames)}"
        return Problem("", message).error()

    def _find(self, name: str) -> Value:
        if name in UNITS:
            return constant(*UNITS[name])
        if self._is_frame(name):
            if self._scene.frame_name(name) not in self._frames and not self._is_fwd_kin(name):
                raise self._no_frame(name)
            message = f"{name} is a 4 x 4 frame, which cannot be indexed or combined"
            raise Problem("", message).error()
        owner, _, key = name.partition(".")
        if self._scene.declares("sources", owner):
            return self._event(owner, key)
        members = self._scene.members(owner)
        if members is not None:
            if any(each not in self._owners for each in members):
                raise DeclarationError([])  # reported elsewhere
            return joined([self._output(each, key) for each in members])
        if owner in self._owners or owner in self._scene.robots:
            return self._output(owner, key)
        if self._scene.is_broken(owner, ("robots", "doubles", "arrows", "groups")):
            raise DeclarationError([])
        raise Problem("", f"no {self._unknown(owner, is_bare=not key)}").error()

    def _event(self, name: str, event: str) -> Value:
        if name not in self._sources:
            raise DeclarationError([])
        events = {**self._sources[name].events, **SIGNALS}
        if self._sources[name].needs_joints(event):
            if self._scene.broken:  # the robot of a route may be invalid
                raise DeclarationError([])
            reason = (
                f"joints of {name} are unknown, because it has no route to all joints of a robot"
            )
            raise Problem("", reason, expected=f"their names in sources.{name}.joints").error()
        if event not in events:
            hint, of = _missing_spaces(event, events), f"of {name}"
            if hint:
                raise Problem("", f"no event '{event}' {of}{hint}").error()
            raise Problem("", "no event", found=event, of=of, available=events).error()
        origin = Origin(name, event, True)
        if origin not in self._events:
            self._events[origin] = numbers_of(origin, tuple(events[event]))
        return self._events[origin]

    def _output(self, name: str, key: str) -> Value:
        item, robots = self._outputs.get(f"{name}.{key}"), self._scene.robots
        if item is None and name in robots and key in MODEL_TORQUES:
            if why := why_unknown(robots, name, key):
                raise Problem("", f"no output '{key}' of {name}: {why}").error()
            item = model_output(robots[name], key)
        if item is not None:
            return numbers_of(Origin(name, key, False), item.shape, units_of(self._scene, item))
        keys = [item.key for item in self._outputs.values() if item.name == name]
        keys += MODEL_TORQUES if name in robots else []
        hint = _missing_spaces(key, keys)
        if not hint and name in robots:
            hint = did_you_mean(key, [*keys, FWD_KIN])
            if nearest(key, [*keys, FWD_KIN]) is None:
                hint += f"; frames are written as {name}/flange"
        message = f"no output '{key}' of {name}{hint or did_you_mean(key, keys)}"
        raise Problem("", message).error()

    def _unknown(self, owner: str, *, is_bare: bool) -> str:
        sources = self._scene.declared("sources")
        if nearest(owner, sources) is None:
            near = nearest(owner, self._owners)
            if near is not None:
                return f"source or robot '{owner}'; did you mean '{near}'?"
            near = nearest(owner, UNITS) if is_bare else None
            if near is not None:
                return f"unit '{owner}'; did you mean '{near}'?"
        return f"source '{owner}'{did_you_mean(owner, sources)}"


def _parsed(origin: str) -> Expression:
    try:
        return parse(origin)
    except RouteError as error:
        raise Problem("", str(error)).error() from None


def _shares(value: Value, items: Sequence[Input], text: str, target: str) -> list[Value]:
    if value.is_constant and not value.shape:
        return [value] * len(items)  # the number is repeated
    full = [item.count for item in items]
    free = [item.count if item.coupled is None else item.coupled.k for item in items]
    found = value.entries.size
    counts = free if found == sum(free) else full
    if found != sum(counts) or value.is_frames:
        many = "1 value" if found == 1 else f"{found} values"
        each = ", ".join(f"{item.name} {item.count}" for item in items)
        fewer = f", or {sum(free)} without the coupled joints" if free != full else ""
        message = f"{text} has {many}, but {target} takes {sum(full)}: {each}{fewer}"
        raise Problem("", message).error()
    return value.split(counts)


def _with_coupled(value: Value, item: Input, coupled: CoupledJoints) -> Value:
    factors, constants = coupled.factors(item.key), coupled.constants(item.key)
    return value.gather(coupled.source, factors, constants)


def _wrong_shape(value: Value, item: Input) -> str:
    count, shape = value.entries.size, value.shape
    many = "1 value" if count == 1 else f"{count} values"
    if item.shape == (4, 4):
        if value.is_frames and count == 16:
            return ""
        found = f"has {many}" if len(shape) < 2 else f"is {' x '.join(map(str, shape))}"
        numbers = f"{len(POSE_NUMBERS)} numbers {', '.join(POSE_NUMBERS)}"
        takes = f"{item.meaning}, 1M in the structure, or {numbers}"
        return f"{found}, but {item.target} takes {takes}"
    if value.is_constant and not shape:
        return ""  # the number is repeated
    if count != item.count:
        return f"has {many}, but {item.target} takes {item.meaning}"
    return f"is a 4 x 4 frame, but {item.target} takes {item.meaning}" if value.is_frames else ""


def _missing_spaces(name: str, known: Iterable[str]) -> str:
    for i, sign in enumerate(name):
        if sign in "-/" and name[:i] in known:
            return f"; write spaces around '{sign}'"
    return ""
