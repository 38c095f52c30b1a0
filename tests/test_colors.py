"""Colors of arrows and doubles as seen with color vision deficiencies."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from sero_mj.robots.declared.double import COMMANDED_RGBA
from sero_mj.viewer.decor.round_arrows import NEGATIVE_RGBA, POSITIVE_RGBA

# Machado, Oliveira, Fernandes: A Physiologically-based Model for Simulation of Color Vision
# Deficiency, IEEE TVCG 15, 2009, table 1, severity 1.0; of linear RGB.
SEEN_BY = {
    "all cones": np.eye(3),
    "no red ones": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "no green ones": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "no blue ones": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}
# IEC 61966-2-1 (sRGB) to XYZ over white.
TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
) / np.array([[0.95047], [1.0], [1.08883]])


def lab(rgb: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Returns CIE 1976 L*a*b* of a color as seen through `cones`."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = TO_XYZ @ np.clip(seen @ linear, 0.0, 1.0)
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("cones", SEEN_BY)
def test_arrow_and_double_colors_are_distinguishable(cones: str) -> None:
    colours = [np.array(rgba[:3]) for rgba in (POSITIVE_RGBA, NEGATIVE_RGBA, COMMANDED_RGBA)]
    for one, other in combinations(colours, 2):
        seen = SEEN_BY[cones]
        assert np.linalg.norm(lab(one, seen) - lab(other, seen)) >= 40.0
