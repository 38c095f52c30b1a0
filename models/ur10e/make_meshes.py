"""Write the link meshes of the Universal Robots UR10e to ``models/ur10e/meshes/``.

The shapes are this project's own design, see ``models/universal_arm.py``, drawn after published
dimensions only.  Lengths are those of the DH table; offsets along axis 2 (176 and 39 mm) and the
radius of the large housings (75 mm) those of physical_parameters.yaml in
UniversalRobots/Universal_Robots_ROS2_Description; the foot of 190 mm and the flange of
ISO 9409-1-50-4-M6 those of UR's data sheet.  The others are estimated.  No UR data of shapes is
used.

One binary STL file is written per link and colour, in metres, in the link's own modified
Denavit-Hartenberg frame.

Run ``python models/ur10e/make_meshes.py``; the output is the same byte for byte on every run.
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
