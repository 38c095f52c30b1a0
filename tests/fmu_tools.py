"""Compiles Functional Mock-up Units of FMI 2 and 3 from C code."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

N = 7
GROUPS = ("angles", "velocities", "target_angles", "gravity")
SOURCES = Path(__file__).with_name("fmu")


def variables_2(names: list[str]) -> str:
    """Returns the FMI 2 variables of vector elements, which are named as by most tools."""
    rows = [
        f'<ScalarVariable name="{name}" valueReference="{k}" causality="parameter" '
        f'variability="tunable" initial="exact"><Real start="{start}"/></ScalarVariable>'
        for k, (name, start) in enumerate((("stiffness", 800.0), ("damping", 40.0)))
    ]
    inputs = [f"{name}[{i}]" for name in names for i in range(1, N + 1)]
    for k, name in enumerate(inputs):
        rows.append(
            f'<ScalarVariable name="{name}" valueReference="{10 + k}" causality="input" '
            'variability="continuous"><Real start="0"/></ScalarVariable>'
        )
    first = len(rows) + 1
    for k in range(N):
        rows.append(
            f'<ScalarVariable name="torques[{k + 1}]" valueReference="{100 + k}" '
            'causality="output" variability="continuous"><Real/></ScalarVariable>'
        )
    unknowns = "".join(f'<Unknown index="{first + k}"/>' for k in range(N))
    return (
        f"<ModelVariables>{''.join(rows)}</ModelVariables><ModelStructure><Outputs>{unknowns}"
        f"</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure>"
    )


def variables_3(names: list[str]) -> str:
    """Returns the FMI 3 variables, which can be vectors."""
    rows = [
        '<Float64 name="time" valueReference="999" causality="independent"/>',
        '<Float64 name="stiffness" valueReference="0" causality="parameter" '
        'variability="tunable" start="800"/>',
        '<Float64 name="damping" valueReference="1" causality="parameter" variability="tunable" '
        'start="40"/>',
    ]
    zeros = " ".join(["0"] * N)
    for k, name in enumerate(names):
        rows.append(
            f'<Float64 name="{name}" valueReference="{10 + N * k}" causality="input" '
            f'start="{zeros}"><Dimension start="{N}"/></Float64>'
        )
    rows.append(
        '<Float64 name="torques" valueReference="100" causality="output">'
        f'<Dimension start="{N}"/></Float64>'
    )
    return (
        f"<ModelVariables>{''.join(rows)}</ModelVariables><ModelStructure>"
        '<Output valueReference="100"/><InitialUnknown valueReference="100"/></ModelStructure>'
    )


def write_fmu(folder: Path, version: int, names: list[str] | None = None, name: str = "") -> str:
    """Compiles a Functional Mock-up Unit and returns its file name."""
    fmpy = pytest.importorskip("fmpy")
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    library, headers = folder / f"impedance{version}.so", Path(fmpy.__file__).parent / "c-code"
    sources = [SOURCES / "fmu.c", *([SOURCES / "stubs.c"] if version == 3 else [])]
    flags = ["-O2", "-ffp-contract=off", "-shared", "-fPIC", f"-I{headers}", f"-DFMI={version}"]
    if not library.exists():
        subprocess.run(["cc", *flags, "-o", library, *sources], check=True)
    token = "guid" if version == 2 else "instantiationToken"
    text = (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="{version}.0" '
        f'modelName="impedance" {token}="{{sero-1}}"><CoSimulation modelIdentifier="impedance" '
        'canHandleVariableCommunicationStepSize="true"/>'
        + (variables_2 if version == 2 else variables_3)(names or [*GROUPS])
        + "</fmiModelDescription>"
    )
    name = name or f"impedance{version}.fmu"
    place = "linux64" if version == 2 else "x86_64-linux"
    with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(library, f"binaries/{place}/impedance.so")
    return name
