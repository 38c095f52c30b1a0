"""Writes the link meshes of the Universal Robots UR5e to `models/ur5e/meshes/`.

The shapes are an original design that uses only published dimensions, see
`models/universal_arm.py`. Lengths are those of the DH table. Offsets along axis 2 (138 and 7 mm)
and the radius of the large housings (60 mm) are those of physical_parameters.yaml in
UniversalRobots/Universal_Robots_ROS2_Description. The foot (149 mm) and the flange
(ISO 9409-1-50-4-M6) are those of the data sheet. Other dimensions are estimated. No shape data from
Universal Robots is used.

One binary STL file is written per link and color, in meters, in the modified Denavit-Hartenberg
frame of the link.

Run `python models/ur5e/make_meshes.py`; every run writes identical files.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import write_links
from universal_arm import UniversalArm, links

ARM = UniversalArm(
    d1=0.1625,
    a2=0.425,
    a3=0.3922,
    d4=0.1333,
    d5=0.0997,
    flange=0.0996,
    foot=0.0745,
    base=0.086,
    shoulder=0.060,
    elbow=0.058,
    wrist=0.0435,
    tool=0.0375,
    upper_tube=0.046,
    lower_tube=0.036,
    shoulder_offset=0.138,
    elbow_offset=0.007,
)

if __name__ == "__main__":
    write_links(Path(__file__).resolve().parent / "meshes", links(ARM), "sero-mj UR5e mesh")
