"""Writes the meshes of the DLR Biped's pelvis to `meshes/`.

An original design in the style of the legs in `models/biped_leg`, in meters. The frame is in the
middle between the hips, with x forward, y left and z up.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import X, Y, Z, loft, write_links

OUT = Path(__file__).resolve().parent / "meshes"

HIPS = 0.10  # distance from the middle to each hip, m


def pelvis():
    """Returns the pelvis with the housing of its electronics."""
    beam = [
        (-HIPS - 0.066, 0.030, 0.050, 2.6, 0.152),
        (-HIPS, 0.042, 0.064, 3.0, 0.158),
        (0.0, 0.048, 0.070, 3.2, 0.166),
        (HIPS, 0.042, 0.064, 3.0, 0.158),
        (HIPS + 0.066, 0.030, 0.050, 2.6, 0.152),
    ]
    trunk = [
        (0.150, 0.064, 0.098, 3.0, -0.004),
        (0.230, 0.070, 0.118, 3.2, -0.008),
        (0.350, 0.076, 0.146, 3.2, -0.012),
        (0.400, 0.062, 0.130, 2.8, -0.012),
    ]
    shield = [(0.250, 0.008, 0.062, 3.2, 0.0585), (0.300, 0.008, 0.078, 3.2, 0.0605),
              (0.350, 0.008, 0.084, 3.2, 0.0590)]  # fmt: skip
    return {
        "white": [loft(beam, (Z, X, Y), edges=(0.02, 0.02), sides=28)],
        "grey": [loft(trunk, edges=(0.012, 0.02), sides=28)],
        "blue": [loft(shield, edges=(0.006, 0.006))],
    }


if __name__ == "__main__":
    write_links(OUT, {"pelvis": pelvis()}, "sero-mj biped mesh, approximate")
