"""`kind = "fmu"`: a Functional Mock-up Unit (FMI 2 and 3, co-simulation), by FMPy.

Simulink, Dymola and OpenModelica export such units. At every step its inputs are set, it makes one
step of the same length, and its outputs are read.
"""

from __future__ import annotations

import ctypes
import re
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from ...base.child_process import add_leftover, remove_leftover
from ...base.errors import Problem, SimulationError
from ...base.frames import Array
from ...base.trust import RequestedAction
from ...robots.declared.robot import SerialRobot
from ...simulate.control.controller import Controller, ControllerDeclaration, Sensed, Target
from ...simulate.control.robot_model import RobotModel
from ...simulate.external_control.exchange import VALUES, State

# How tools number the elements of a vector, from 1 or from 0.
_ELEMENT = re.compile(r"(?P<name>.+?)(?:\[(?P<a>\d+)\]|[._](?P<b>\d+)|\((?P<c>\d+)\))$")
_TORQUES = "torques"


class Fmu(ControllerDeclaration):
    """A Functional Mock-up Unit.

    Variables are taken by their names: an input `angles`, a vector, or `angles[1]`, `angles_1` and
    so on, its elements; outputs `torques` likewise. A vector must have one number per joint.

    Attributes:
        file: the unit, controller.fmu say; relative to the scenario's folder.
        inputs: its inputs that are named otherwise, one by one or whole vectors (`q` for q_0, q_1
            and so on), to what they get: angles, velocities, torques,
            motor_angles, motor_velocities, gravity, target_angles, target_velocities,
            target_accelerations, or an element of these, `angles[1]` for the first joint.
        output: the name of its outputs with torques.
        parameters: of its parameters, the values that they get.
    """

    may_be_probed: ClassVar[bool] = False
    title: ClassVar[str] = "FMU"
    order: ClassVar[int] = 80

    kind: Literal["fmu"] = "fmu"
    file: Path
    inputs: dict[str, str] = {}
    output: str = _TORQUES
    parameters: dict[str, float] = {}

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        """None: there is no unit."""
        return None

    def actions(self, key: str = "") -> list[RequestedAction]:
        return [RequestedAction(key, f"load the FMU {self.file}", (self.file,))]

    def check_files(self) -> None:
        if not self.file.is_file():
            raise Problem("file", f"no file {self.file}").error()

    def make(self, model: RobotModel, timestep: float) -> FmuController:
        """The controller; raises DeclarationError where the unit does not fit the robot."""
        try:
            import fmpy
        except ImportError as error:
            hint = f"needs FMPy ({error}): pip install 'sero-mj[fmu]'"
            raise Problem("kind", hint).error() from None
        self.check_files()
        try:
            description = fmpy.read_model_description(str(self.file))
        except Exception as error:  # FMPy, zipfile and lxml raise many kinds
            raise Problem("file", f"{self.file} is no FMU: {error}").error() from None
        version = str(description.fmiVersion)[:1]
        if description.coSimulation is None or version not in ("2", "3"):
            found = f"{self.file} is of FMI {description.fmiVersion}"
            problem = Problem("file", found, expected="FMI 2 or 3 with co-simulation")
            raise problem.error()
        return FmuController(self, description, model, timestep)


class FmuController(Controller):
    """Steps a unit in every step of the simulation.

    Args:
        timestep: s between two steps.

    Raises:
        DeclarationError: its variables do not fit the robot.
    """

    def __init__(self, declared: Fmu, description: Any, model: RobotModel, timestep: float) -> None:
        self._declared, self._description = declared, description
        self._model, self._timestep = model, timestep
        self._is_3 = str(description.fmiVersion).startswith("3")
        variables = description.modelVariables
        inputs = [each for each in variables if each.causality == "input"]
        outputs = [each for each in variables if each.causality == "output"]
        meant = _meant([each.name for each in inputs], declared.inputs)
        places = {name: _place(text, model.n, [*meant.values()]) for name, text in meant.items()}
        wrong = [name for name, place in places.items() if place is None]
        if wrong:
            expected = f'inputs of {", ".join(VALUES)}, or inputs.{wrong[0]} = "..."'
            raise Problem("inputs", found=", ".join(wrong[:5]), expected=expected).error()
        fitting = {name: place for name, place in places.items() if place is not None}
        for each in inputs:
            _check_size(f"inputs.{each.name}", each, fitting[each.name].joints.size)
        taken = [*fitting.values()]
        self._outputs = _torques(outputs, declared.output, model.n)
        names = [*dict.fromkeys(place.name for place in taken)]
        text = " ".join(f"{name}:{model.n}d" for name in names)
        self._state = State(f"< {text}", model) if text else None
        packet = b"" if self._state is None else self._state.packet
        self._numbers = np.frombuffer(packet, np.float64)
        indices = [model.n * names.index(place.name) + place.joints for place in taken]
        self._places: Any = np.concatenate([*indices, np.zeros(0, np.intp)])
        self._inputs = [each.valueReference for each in inputs]
        self._parameters = _parameters(variables, declared.parameters)
        self._unit: Any = None

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,).

        Raises:
            SimulationError: the unit cannot be initialised, or fails.
        """
        if self._unit is None:
            self._begin(sensed)
        if self._state is not None:
            self._state.fill(1, sensed, target)
        try:
            self._exchange(sensed.time, out)
        except Exception as error:  # of FMPy
            self.close()
            what = f"{self._declared.file}: {error or type(error).__name__}"
            raise SimulationError(sensed.time, self._model.name, what) from error

    def close(self) -> None:
        """Ends the unit; harmless when it has ended."""
        if self._unit is not None:
            self._end()
        self._unit = None

    def _begin(self, sensed: Sensed) -> None:
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        description, folder = self._description, tempfile.mkdtemp(prefix="sero-mj-fmu-")
        add_leftover(Path(folder))
        try:
            fmpy.extract(str(self._declared.file), folder)
            unit = (FMU3Slave if self._is_3 else FMU2Slave)(
                guid=description.guid,
                unzipDirectory=folder,
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName=self._model.name,
            )
            unit.instantiate()
            if not self._is_3:
                unit.setupExperiment(startTime=sensed.time)
            if self._parameters:
                set_numbers = unit.setFloat64 if self._is_3 else unit.setReal
                set_numbers([*self._parameters], [*self._parameters.values()])
            if self._is_3:
                unit.enterInitializationMode(startTime=sensed.time)
            else:
                unit.enterInitializationMode()
            unit.exitInitializationMode()
        except Exception as error:  # of FMPy, or of the loader of libraries
            remove_leftover(Path(folder))
            what = f"{self._declared.file} cannot be initialised: {error or type(error).__name__}"
            raise SimulationError(sensed.time, self._model.name, what) from error
        self._unit = unit
        self._end = weakref.finalize(self, _end, unit, folder)
        # FMPy's own methods make new arrays at every call, which takes longer than the unit.
        count = len(self._places)
        self._given: Array = np.zeros(max(count, 1))
        self._taken: Array = np.zeros(self._model.n)
        self._references = (
            (ctypes.c_uint32 * max(len(self._inputs), 1))(*self._inputs),
            (ctypes.c_uint32 * len(self._outputs))(*self._outputs),
        )
        double = ctypes.POINTER(ctypes.c_double)
        self._arrays = self._given.ctypes.data_as(double), self._taken.ctypes.data_as(double)

    def _exchange(self, time: float, out: Array) -> None:
        unit, (inputs, outputs), (given, taken) = self._unit, self._references, self._arrays
        self._given[: len(self._places)] = self._numbers[self._places]
        if self._is_3:
            if self._inputs:
                unit.fmi3SetFloat64(
                    unit.component, inputs, len(self._inputs), given, len(self._places)
                )
            unit.doStep(time, self._timestep)
            unit.fmi3GetFloat64(unit.component, outputs, len(self._outputs), taken, self._model.n)
        else:
            if self._inputs:
                unit.fmi2SetReal(unit.component, inputs, len(self._inputs), given)
            unit.doStep(time, self._timestep)
            unit.fmi2GetReal(unit.component, outputs, len(self._outputs), taken)
        out[:] = self._taken

    def __getstate__(self) -> Any:
        raise TypeError("a loaded FMU is of this process")


class _Place(NamedTuple):
    name: str
    joints: Any


def _meant(names: Sequence[str], wanted: Mapping[str, str]) -> dict[str, str]:
    vectors = {name: found["name"] for name in names if (found := _ELEMENT.match(name))}
    available = {*names, *vectors.values()}
    for name in wanted:
        if name not in available:
            raise Problem(f"inputs.{name}", "no input", found=name, available=available).error()
    meant = {}
    for name in names:
        vector = vectors.get(name, "")
        default = name
        if vector in wanted:  # `q_3` of `q = "angles"` is `angles_3`
            default = wanted[vector] + name.removeprefix(vector)
        meant[name] = wanted.get(name, default)
    return meant


def _place(text: str, n: int, names: Sequence[str]) -> _Place | None:
    if text in VALUES:
        return _Place(text, np.arange(n))
    found = _ELEMENT.match(text)
    if found is None or found["name"] not in VALUES:
        return None
    index = _number(found) - _first(found["name"], names)
    return _Place(found["name"], np.array([index])) if 0 <= index < n else None


def _number(found: re.Match[str]) -> int:
    return int(found["a"] or found["b"] or found["c"])


def _first(name: str, names: Sequence[str]) -> int:
    numbers = [
        _number(found)
        for each in names
        if (found := _ELEMENT.match(each)) is not None and found["name"] == name
    ]
    return 0 if 0 in numbers else 1


def _check_size(key: str, variable: Any, expected: int) -> None:
    size = int(np.prod(variable.shape or ()))  # 1 for a scalar, all that FMI 2 has
    if size != expected:
        of = f"number{'s' * (size != 1)} in variable {variable.name} of the unit"
        raise Problem(key, found=size, of=of, expected=expected).error()


def _torques(outputs: Sequence[Any], name: str, n: int) -> list[int]:
    whole = [each for each in outputs if each.name == name]
    if whole:
        _check_size("output", whole[0], n)
        return [whole[0].valueReference]
    names = sorted(each.name for each in outputs)
    first = _first(name, names)
    for each in outputs:
        if (found := _ELEMENT.match(each.name)) is not None and found["name"] == name:
            _check_size("output", each, 1)
    by_joint = {
        _number(found) - first: each.valueReference
        for each in outputs
        if (found := _ELEMENT.match(each.name)) is not None and found["name"] == name
    }
    if sorted(by_joint) != [*range(n)]:
        found_names = ", ".join(names[:10]) or "none"
        expected = f'{name}, or {name}[1] to {name}[{n}]; output = "..." names them otherwise'
        raise Problem("output", found=f"the outputs {found_names}", expected=expected).error()
    return [by_joint[joint] for joint in range(n)]


def _parameters(variables: Sequence[Any], wanted: Mapping[str, float]) -> dict[int, float]:
    known = {each.name: each for each in variables if each.causality == "parameter"}
    for name in wanted:
        if name not in known:
            raise Problem(f"parameters.{name}", "no parameter", found=name, available=known).error()
    return {known[name].valueReference: value for name, value in wanted.items()}


def _end(unit: Any, folder: str) -> None:
    try:
        unit.terminate()
        unit.freeInstance()
    except Exception:  # of a unit that has failed
        pass
    remove_leftover(Path(folder))
