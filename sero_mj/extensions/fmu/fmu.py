"""`kind = "fmu"`: a Functional Mock-up Unit (FMI 2 or 3, co-simulation), run with FMPy.

Simulink, Dymola and OpenModelica export FMUs. In each simulation step, the controller sets the
inputs of the FMU, advances it by one step of the same length, and reads its outputs.
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

# Tools name the elements of a vector `q[1]`, `q_1`, `q.1` or `q(1)`, counted from 1 or 0.
_ELEMENT = re.compile(r"(?P<name>.+?)(?:\[(?P<a>\d+)\]|[._](?P<b>\d+)|\((?P<c>\d+)\))$")
_TORQUES = "torques"


class Fmu(ControllerDeclaration):
    """A controller in a Functional Mock-up Unit.

    Inputs and outputs are matched by name. The FMU can have an input vector `angles` with one
    number per joint, or one input per joint (`angles[1]`, `angles_1` and so on). The same applies
    to the outputs `torques`.

    Attributes:
        file: FMU file, for example `controller.fmu`, relative to the scenario's folder.
        inputs: table that maps inputs of the FMU with different names to values: angles,
            velocities, torques, motor_angles, motor_velocities, gravity, target_angles,
            target_velocities, target_accelerations, or an element of these (`angles[1]` for the
            first joint). The name `q` stands for the inputs q_0, q_1 and so on.
        output: name of the outputs that contain torques.
        parameters: table that maps parameters of the FMU to their values.
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
        return None  # there is no default FMU

    def actions(self, key: str = "") -> list[RequestedAction]:
        return [RequestedAction(key, f"load the FMU {self.file}", (self.file,))]

    def check_files(self) -> None:
        if not self.file.is_file():
            raise Problem("file", f"{self.file} does not exist").error()

    def make(self, model: RobotModel, timestep: float) -> FmuController:
        try:
            import fmpy
        except ImportError as error:
            hint = f"fmu requires FMPy ({error}): pip install 'sero-mj[fmu]'"
            raise Problem("kind", hint).error() from None
        self.check_files()
        try:
            description = fmpy.read_model_description(str(self.file))
        except Exception as error:  # FMPy, zipfile and lxml raise many kinds
            raise Problem("file", f"{self.file} is not an FMU: {error}").error() from None
        version = str(description.fmiVersion)[:1]
        if description.coSimulation is None or version not in ("2", "3"):
            has = "without" if description.coSimulation is None else "with"
            found = f"{self.file} uses FMI {description.fmiVersion} {has} co-simulation"
            problem = Problem("file", found, expected="FMI 2 or 3 with co-simulation")
            raise problem.error()
        return FmuController(self, description, model, timestep)


class FmuController(Controller):
    """Advances an FMU in each simulation step.

    Raises:
        DeclarationError: the variables of the FMU do not match the robot.
    """

    def __init__(self, declared: Fmu, description: Any, model: RobotModel, timestep: float) -> None:
        self._declared, self._description = declared, description
        self._model, self._timestep = model, timestep
        self._is_3 = str(description.fmiVersion).startswith("3")
        variables = description.modelVariables
        inputs = [each for each in variables if each.causality == "input"]
        outputs = [each for each in variables if each.causality == "output"]
        values = _input_values([each.name for each in inputs], declared.inputs)
        places = {name: _place(text, model.n, [*values.values()]) for name, text in values.items()}
        wrong = [name for name, place in places.items() if place is None]
        if wrong:
            expected = f'{", ".join(VALUES)}. Map other inputs with inputs."{wrong[0]}" = "..."'
            reason = "the FMU has unknown inputs"
            raise Problem("inputs", reason, found=", ".join(wrong[:5]), expected=expected).error()
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
        if self._unit is None:
            self._begin(sensed)
        if self._state is not None:
            self._state.fill(1, sensed, target)
        try:
            self._exchange(sensed.time, out)
        except Exception as error:  # FMPy raises many kinds
            self.close()
            what = f"{self._declared.file}: {error or type(error).__name__}"
            raise SimulationError(sensed.time, self._model.name, what) from error

    def close(self) -> None:
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
        except Exception as error:  # FMPy and the loader of libraries raise many kinds
            remove_leftover(Path(folder))
            what = f"{self._declared.file} cannot be initialized: {error or type(error).__name__}"
            raise SimulationError(sensed.time, self._model.name, what) from error
        self._unit = unit
        self._end = weakref.finalize(self, _end, unit, folder)
        # The methods of FMPy allocate arrays in every call, which can take longer than the FMU.
        count = len(self._places)
        self._input_buffer: Array = np.zeros(max(count, 1))
        self._output_buffer: Array = np.zeros(self._model.n)
        self._references = (
            (ctypes.c_uint32 * max(len(self._inputs), 1))(*self._inputs),
            (ctypes.c_uint32 * len(self._outputs))(*self._outputs),
        )
        double = ctypes.POINTER(ctypes.c_double)
        self._pointers = (
            self._input_buffer.ctypes.data_as(double),
            self._output_buffer.ctypes.data_as(double),
        )

    def _exchange(self, time: float, out: Array) -> None:
        unit, (inputs, outputs), (sent, received) = self._unit, self._references, self._pointers
        self._input_buffer[: len(self._places)] = self._numbers[self._places]
        if self._is_3:
            if self._inputs:
                unit.fmi3SetFloat64(
                    unit.component, inputs, len(self._inputs), sent, len(self._places)
                )
            unit.doStep(time, self._timestep)
            unit.fmi3GetFloat64(
                unit.component, outputs, len(self._outputs), received, self._model.n
            )
        else:
            if self._inputs:
                unit.fmi2SetReal(unit.component, inputs, len(self._inputs), sent)
            unit.doStep(time, self._timestep)
            unit.fmi2GetReal(unit.component, outputs, len(self._outputs), received)
        out[:] = self._output_buffer

    def __getstate__(self) -> Any:
        raise TypeError("a loaded FMU cannot be pickled")


class _Place(NamedTuple):
    name: str
    joints: Any


def _input_values(names: Sequence[str], wanted: Mapping[str, str]) -> dict[str, str]:
    vectors = {name: found["name"] for name in names if (found := _ELEMENT.match(name))}
    available = {*names, *vectors.values()}
    for name in wanted:
        if name not in available:
            reason = "the FMU has no input"
            raise Problem(f"inputs.{name}", reason, found=name, available=available).error()
    values = {}
    for name in names:
        vector = vectors.get(name, "")
        default = name
        if vector in wanted:  # `q = "angles"` maps `q_3` to `angles_3`
            default = wanted[vector] + name.removeprefix(vector)
        values[name] = wanted.get(name, default)
    return values


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
    size = int(np.prod(variable.shape or ()))  # 1 for a scalar; FMI 2 has only scalars
    if size != expected:
        of = f"number{'s' * (size != 1)} in variable {variable.name} of the FMU"
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
        expected = f"{name}, or {name}[1] to {name}[{n}]. Set output to a different name"
        reason = f"the FMU has the outputs {found_names}"
        raise Problem("output", reason, expected=expected).error()
    return [by_joint[joint] for joint in range(n)]


def _parameters(variables: Sequence[Any], wanted: Mapping[str, float]) -> dict[int, float]:
    known = {each.name: each for each in variables if each.causality == "parameter"}
    for name in wanted:
        if name not in known:
            reason = "the FMU has no parameter"
            raise Problem(f"parameters.{name}", reason, found=name, available=known).error()
    return {known[name].valueReference: value for name, value in wanted.items()}


def _end(unit: Any, folder: str) -> None:
    try:
        unit.terminate()
        unit.freeInstance()
    except Exception:  # An FMU that has failed may raise again.
        pass
    remove_leftover(Path(folder))
