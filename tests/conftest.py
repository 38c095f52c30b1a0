"""Chooses the OpenGL backend before anything imports mujoco, and holds what tests share."""

from __future__ import annotations

from sero_mj.show.headless.gl import choose_backend

choose_backend()

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from sero_mj.assemble.robot import SerialRobot
from sero_mj.assemble.scene import Scene
from sero_mj.assemble.world import World

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def lwr() -> SerialRobot:
    return SerialRobot.from_model("lwr")


@pytest.fixture(scope="session")
def lwr_world(lwr: SerialRobot) -> World:
    """The LWR without a floor; tests make their own data."""
    return World(Scene(robots=[lwr], floor=False))


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, as Playwright works it."""
    from playwright.sync_api import sync_playwright
    from web_tools import ARGUMENTS, CHROMIUM

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()
