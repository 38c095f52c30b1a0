"""Write the link meshes of the Universal Robots UR5e to ``models/ur5e/meshes/``.

The shapes are this project's own design, see ``models/universal_arm.py``, drawn after published
dimensions only.  Lengths are those of the DH table; offsets along axis 2 (138 and 7 mm) and the
radius of the large housings (60 mm) those of physical_parameters.yaml in
UniversalRobots/Universal_Robots_ROS2_Description; the foot of 149 mm and the flange of
ISO 9409-1-50-4-M6 those of UR's data sheet.  The others are estimated.  No UR data of shapes is
used.

One binary STL file is written per link and colour, in metres, in the link's own modified
Denavit-Hartenberg frame.

Run ``python models/ur5e/make_meshes.py``; the output is the same byte for byte on every run.
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
