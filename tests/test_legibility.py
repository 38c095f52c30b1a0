"""Billboards read back from rendered images by an OCR program."""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from conftest import examples, sampled
from decor_tools import world_of
from numpy.typing import NDArray
from PIL import Image

from sero_mj.data.drive.place import follow
from sero_mj.robots.assemble.world import World
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.image.render import HeadlessRenderer

POSES = examples(44)  # and as many cameras
MOST_WRONG = 0.02  # of all values
ENLARGED = 2  # times, because tesseract is made for scanned print
PANEL = 100  # of 255: the brightest background of letters
MARGIN = 20  # pixels of white between two panels
LINES = [
    {"value": "torques"},
    {"value": "joint_angles", "unit": "deg", "scale": 57.29577951308232, "decimals": 1},
]
NUMBER = re.compile(r"-?\d+[.,]\d+")  # the font's decimal point looks like a comma


@dataclass
class Panel:
    """One billboard of an image: its pixels, and the values that it should show."""

    pixels: NDArray[np.uint8]
    numbers: list[str]
    place: str


def panels_in(renderer: HeadlessRenderer, data: mujoco.MjData, place: str) -> list[Panel]:
    """Renders an image and cuts out its billboards."""
    picture = renderer.render(data)
    view, geoms, joints = renderer.decor.view, renderer.decor.buffer, renderer.world.joints
    assert view is not None
    anchors, depth = view.project(data.site_xpos[joints.centre_site])
    shown = (geoms.kinds[: geoms.count] == Kind.BILLBOARD).nonzero()[0]
    # Each joint inside the image has its billboard, and the others have none.
    assert sorted(geoms.items[shown]) == view.sees(anchors, depth).nonzero()[0].tolist()
    torques = data.userdata[renderer.world.slots["lwr.torques"]]
    found, taken = [], np.zeros(picture.shape[:2], bool)
    for row, joint in zip(geoms.rows[shown], geoms.items[shown], strict=True):
        (x, y), far = view.project(row["pos"].astype(float))
        half = row["size"][:2] / view.pixel_size(float(far))
        left, right = round(float(x - half[0])), round(float(x + half[0]))
        top, bottom = (round(float(view.height - y + s * half[1])) for s in (-1, 1))
        assert left >= 0 and right <= view.width and top >= 0 and bottom <= view.height
        assert not taken[top:bottom, left:right].any(), f"{place}: panels cover each other"
        taken[top:bottom, left:right] = True
        angle = np.rad2deg(data.qpos[joints.qpos[joint]])
        numbers = [f"{torques[joint]:.1f}", f"{angle:.1f}"]
        found.append(Panel(picture[top:bottom, left:right], numbers, f"{place} joint {joint}"))
    return found


def read(panels: list[Panel]) -> list[list[str]]:
    """Returns the values that tesseract finds in each panel."""
    crops = []
    for panel in panels:
        light = Image.fromarray(panel.pixels).convert("L")
        # Letters are white and everything else is darker: inverted, as on paper.
        paper = light.point(lambda value: 255 - max(value - PANEL, 0) * 255 // (255 - PANEL))
        larger = (paper.width * ENLARGED, paper.height * ENLARGED)
        crops.append(paper.resize(larger, Image.Resampling.BICUBIC))
    width = max(crop.width for crop in crops) + 2 * MARGIN
    page = Image.new("L", (width, sum(crop.height + MARGIN for crop in crops) + MARGIN), 255)
    tops = []
    for crop in crops:
        tops.append(MARGIN + sum(c.height + MARGIN for c in crops[: len(tops)]))
        page.paste(crop, (MARGIN, tops[-1]))
    buffer = io.BytesIO()
    page.save(buffer, "png")
    done = subprocess.run(
        ["tesseract", "-", "-", "--psm", "6", "tsv"],
        input=buffer.getvalue(),
        capture_output=True,
        check=True,
        env={**os.environ, "OMP_THREAD_LIMIT": "1"},
    )
    table = csv.DictReader(
        io.StringIO(done.stdout.decode()), delimiter="\t", quoting=csv.QUOTE_NONE
    )
    words: list[list[str]] = [[] for _ in panels]
    for row in table:
        if row["text"].strip():
            middle = int(row["top"]) + int(row["height"]) / 2
            words[max(int(np.searchsorted(tops, middle)) - 1, 0)].append(row["text"])
    return [
        [number.replace(",", ".") for number in NUMBER.findall(" ".join(of_panel))]
        for of_panel in words
    ]


@pytest.fixture(scope="module")
def world() -> World:
    return world_of(show_billboards=True, billboard_lines=LINES)


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("tesseract") is None,
    reason="tesseract is not installed: apt-get install tesseract-ocr",
)
@pytest.mark.parametrize("size", sampled([(1280, 800), (640, 480)], 1))
def test_ocr_program_reads_the_values_of_all_billboards(
    world: World, size: tuple[int, int]
) -> None:
    rng = np.random.default_rng(size[0])
    limits = world.robots["lwr"].robot.position_limits
    assert limits is not None
    data, pictures = world.make_data(), []
    with HeadlessRenderer(world, *size) as renderer:
        for k in range(POSES):
            data.qpos[:] = 0.9 * rng.uniform(limits[:, 0], limits[:, 1])
            world.set_input(data, "lwr.torques", rng.uniform(-200, 200, 7))
            follow(world.model, data)
            camera = renderer.camera
            camera.azimuth, camera.elevation = rng.uniform(0, 360), rng.uniform(-60, 20)
            camera.distance = rng.uniform(1.5, 3.5)
            pictures.append(panels_in(renderer, data, f"picture {k}"))
    with ThreadPoolExecutor(2) as pool:
        numbers = [found for page in pool.map(read, pictures) for found in page]
    asked, wrong = 0, []
    for panel, found in zip([p for page in pictures for p in page], numbers, strict=True):
        asked += len(panel.numbers)
        missing = [n for k, n in enumerate(panel.numbers) if found[k : k + 1] != [n]]
        wrong += [f"{panel.place}: {number} read as {found}" for number in missing]
    assert asked > 11 * POSES
    assert len(wrong) <= MOST_WRONG * asked, "\n".join([f"{len(wrong)} of {asked}", *wrong])
    print(f"{asked - len(wrong)} of {asked} numbers read right at {size[0]}x{size[1]}")
