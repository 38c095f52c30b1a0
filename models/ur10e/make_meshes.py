"""Writes the link meshes of the Universal Robots UR10e to `models/ur10e/meshes/`.

The shapes are an original design that uses only published dimensions, see
`models/universal_arm.py`. Lengths are those of the DH table. Offsets along axis 2 (176 and 39 mm)
and the radius of the large housings (75 mm) are those of physical_parameters.yaml in
UniversalRobots/Universal_Robots_ROS2_Description. The foot (190 mm) and the flange
(ISO 9409-1-50-4-M6) are those of the data sheet. Other dimensions are estimated. No shape data from
Universal Robots is used.

One binary STL file is written per link and color, in meters, in the modified Denavit-Hartenberg
frame of the link.

Run `python models/ur10e/make_meshes.py`; every run writes identical files.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from bodies import write_links
from universal_arm import UniversalArm, links

ARM = UniversalArm(
    d1=0.1807,
    a2=0.6127,
    a3=0.57155,
    d4=0.17415,
    d5=0.11985,
    flange=0.11655,
    foot=0.095,
    base=0.088,
    shoulder=0.075,
    elbow=0.060,
    wrist=0.0500,
    tool=0.0400,
    upper_tube=0.054,
    lower_tube=0.043,
    shoulder_offset=0.1762,
    elbow_offset=0.0393,
)

if __name__ == "__main__":
    write_links(Path(__file__).resolve().parent / "meshes", links(ARM), "sero-mj UR10e mesh")
