"""Robots with many joints: which joints have billboards, on which side, and clicks."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from decor_tools import toggles_of, view_at
from humanoid import humanoid
from scripted_widgets import ScriptedWidgets

import sero_mj
from sero_mj.data.drive.place import follow
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation
from sero_mj.study.align import align
from sero_mj.study.compare import as_table as pair_table
from sero_mj.study.compare import compare
from sero_mj.study.summary import as_table as summary_table
from sero_mj.study.summary import summarise
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.decor.panels import Panels
from sero_mj.viewer.image.clicks import click
from sero_mj.viewer.image.picking import Picked
from sero_mj.viewer.panels.robot_panel import RobotPanel

SIZES = [(1280, 800), (640, 480)]


@pytest.fixture
def world() -> World:
    return World(Scene(robots=[humanoid(show_billboards=True, show_arrows=True)], floor=False))


def loaded(world: World, shares: np.ndarray) -> mujoco.MjData:
    data = world.make_data()
    world.set_input(data, "human.torques", shares * world.robots["human"].robot.torque_limits)
    follow(world.model, data)
    return data


def cards_of(decor: Decor) -> Panels:
    (cards,) = (panels for panels in decor.panels if panels.kind == Kind.BILLBOARD)
    return cards


def limbs_of(decor: Decor) -> dict[str, list[bytes]]:
    """Returns the lines of the limb billboards by limb name."""
    limbs = [panels for panels in decor.panels if panels.kind == Kind.LIMB]
    texts = [text for panels in limbs for text in panels.texts]
    return {text[0].partition(b"  ")[0].decode(): text for text in texts}


def on_link(world: World, joint: str) -> Picked:
    index = world.joints.names.index(joint)
    return Picked("link", f"human/link{index + 1}", "human", index, 1.0)


def rows_of(world: World, limb: str) -> list[int]:
    return world.robots["human"].robot.limb_joints[limb]


@pytest.mark.parametrize("size", SIZES)
def test_joints_with_the_largest_shares_have_billboards(size: tuple[int, int]) -> None:
    snake = sero_mj.SerialRobot(
        name="human",
        dh_convention="craig",
        dh_params=[[0.0, 0.03, 0.0, 0.0]] * 62,
        torque_limits=[10.0] * 62,
        show_billboards=True,
    )
    world = World(Scene(robots=[snake], floor=False))
    shares = np.random.default_rng(2).permutation(np.linspace(-0.9, 0.9, 62))
    data, toggles, decor = loaded(world, shares), toggles_of(world), Decor(world)
    toggles.arrows[:] = True
    view = view_at(distance=4.0, width=size[0], height=size[1])
    decor.draw(data, toggles, view)
    cards = cards_of(decor)
    most, count = set(np.argsort(-np.abs(shares))[:12].tolist()), len(cards.texts)
    assert set(cards.items.tolist()) <= most
    assert count == 12 if size == SIZES[0] else 8 <= count <= 12  # as many as there is space for
    notes = [line for panels in decor.panels for lines in panels.texts for line in lines]
    assert b"%d of 62 joints shown: highest loads" % count in notes
    low, high = cards.centres - cards.sizes / 2, cards.centres + cards.sizes / 2
    apart = ((high[:, None] <= low + 1e-6) | (low[:, None] >= high - 1e-6)).any(axis=2)
    assert (apart | np.eye(count, dtype=bool)).all()
    assert (low >= 0).all() and (high <= size).all()
    assert toggles.arrows.sum() == world.robots["human"].robot.n


@pytest.mark.parametrize("size", SIZES)
def test_click_shows_a_limb_first_and_a_second_one_hides_it(
    world: World, size: tuple[int, int]
) -> None:
    shares = np.linspace(0.9, 0.1, 62)  # the legs have the largest shares
    data, toggles, decor = loaded(world, shares), toggles_of(world), Decor(world)
    view = view_at(distance=4.0, width=size[0], height=size[1])
    click(world, toggles, on_link(world, "l_elbow"))
    decor.draw(data, toggles, view)
    arm = rows_of(world, "l_arm")
    shown = set(cards_of(decor).items.tolist())
    assert {*arm} <= shown
    assert "l_arm" not in limbs_of(decor)
    click(world, toggles, on_link(world, "l_elbow"))
    decor.draw(data, toggles, view)
    shown = {
        item
        for panels in decor.panels
        if panels.kind == Kind.BILLBOARD and panels.items is not None
        for item in panels.items.tolist()
    }
    assert not shown & {*arm}
    assert "l_arm" not in limbs_of(decor)


def test_limbs_have_one_billboard_each_with_their_most_loaded_joint(world: World) -> None:
    shares = np.random.default_rng(2).permutation(np.linspace(-0.9, 0.9, 62))
    data, decor = loaded(world, shares), Decor(world)
    decor.draw(data, toggles_of(world), view_at(distance=4.0, width=640, height=480))
    limbs = limbs_of(decor)
    rows = world.robots["human"].robot.limb_joints
    hands = {
        f"{side}_hand": [i for name, each in rows.items() if name[0] == side for i in each
                         if name[1:] not in ("_arm", "_leg")]
        for side in "lr"
    }  # fmt: skip
    assert {*hands} <= {*limbs}
    for name, (count, most) in limbs.items():
        mine = (rows | hands)[name]
        assert count.split()[-2:] == [str(len(mine)).encode(), b"joints"]
        assert most.split()[-2:] == [b"%.0f" % (100 * np.abs(shares[mine]).max()), b"%"]


def test_click_alone_shows_all_joints_of_a_limb_on_one_side(world: World) -> None:
    data, toggles, decor = loaded(world, np.full(62, 0.1)), toggles_of(world), Decor(world)
    toggles.billboards[:] = False
    click(world, toggles, on_link(world, "r_knee"))
    legs = {}
    for azimuth in (0.0, np.pi):  # seen from behind and from the front
        view = view_at(azimuth, distance=3.0)
        decor.draw(data, toggles, view)
        cards = cards_of(decor)
        assert cards.items.tolist() == rows_of(world, "r_leg")
        sides = cards.centres[:, 0] < view.width / 2
        assert sides.all() or not sides.any()
        legs[azimuth] = bool(sides[0])
    assert legs == {0.0: False, np.pi: True}


def test_serial_robots_show_the_clicked_joint() -> None:
    world = World(Scene(robots=[sero_mj.SerialRobot.from_model("lwr")], floor=False))
    toggles = toggles_of(world)
    click(world, toggles, Picked("link", "lwr/link3", "lwr", 2, 1.0))
    assert toggles.billboards.nonzero()[0].tolist() == [2]
    click(world, toggles, Picked("link", "lwr/link3", "lwr", 2, 1.0))
    assert not toggles.billboards.any()


def test_robots_in_third_party_models_have_the_same_limbs() -> None:
    robot = humanoid()
    own = World(Scene(robots=[robot], floor=False), dynamic=True)
    overlay = sero_mj.overlay(own.model)
    (part,) = overlay.world.robots.values()
    found = {
        tuple(part.robot.names[i].rpartition("/")[2] for i in joints)
        for joints in part.robot.limb_joints.values()
    }
    names = [*robot.limb_joints.values()]
    assert found == {tuple(robot.names[i] for i in joints) for joints in names}


def test_panel_lists_limbs_as_foldable_groups(world: World) -> None:
    toggles = toggles_of(world)
    ui = ScriptedWidgets({"billboards##l_arm": False})
    RobotPanel(world, toggles).build(ui)
    limbs = world.robots["human"].robot.limb_joints
    trees = [label for kind, label in ui.built if kind == "tree"]
    assert trees == ["joints", *limbs, "sizes"]
    rows = [label.partition("##")[0] for kind, label in ui.built if kind == "select"]
    assert rows == [world.joints.names[i] for joints in limbs.values() for i in joints]
    hidden = np.flatnonzero(~toggles.billboards)
    assert hidden.tolist() == limbs["l_arm"]


def test_joints_can_be_searched_and_selected(world: World) -> None:
    toggles = toggles_of(world)
    panel, selected = RobotPanel(world, toggles), list[int]()
    panel.on_select = selected.append
    panel.build(ScriptedWidgets({"##search": "L_THUMB"}))  # typed; shown from the next frame on
    wanted = [i for i, name in enumerate(world.joints.names) if "l_thumb" in name.lower()]
    toggles.selected = wanted[1]
    last = f"human/{world.joints.names[wanted[-1]]}##found{wanted[-1]}"
    ui = ScriptedWidgets({last: True})
    panel.build(ui)
    found = [label.partition("##")[0] for kind, label in ui.built if kind == "select"]
    assert found == [f"human/{world.joints.names[i]}" for i in wanted]
    assert ui.texts() == [f"{len(wanted)} of {len(world.joints.names)} joints"]
    assert ui.lit == [f"{found[1]}##found{wanted[1]}"]
    assert selected == [wanted[-1]]
    panel.build(ScriptedWidgets({"##search": ""}))
    ui = ScriptedWidgets()
    panel.build(ui)
    assert any(kind == "tree" for kind, _ in ui.built)


@pytest.mark.thorough
def test_tables_show_the_most_loaded_joints_and_files_all() -> None:
    robot = humanoid("body", show_arrows=True)
    logs = []
    for stiffness in (30.0, 60.0):
        hold = {"kind": "joint_impedance", "stiffness": stiffness, "damping": 0.7}
        law = {"kind": "sine", "amplitude_deg": 5, "frequency": 2.0, "ramp": 0.0}
        scenario = Scenario(
            Scene(robots=[robot], floor=False), controllers={"body": hold}, targets={"body": law},
            duration=0.1,
        )  # fmt: skip
        simulation = Simulation(scenario)
        simulation.advance(simulation.steps)
        logs.append(simulation.log)
    rows = summarise(logs[0])
    table = summary_table(rows)
    assert len(rows) == 62 and table.row_count == 12
    assert table.caption == "the 12 most loaded of 62 joints; --json prints all"
    shares = sorted((row.peak_share or 0.0 for row in rows), reverse=True)[:12]
    shown = {row.joint: row.peak_share for row in rows}
    assert min(shown[name] for name in table.columns[0].cells) == shares[-1]
    pair = align(*logs, "body", 0.0)
    differences = compare(pair)
    assert len({each.joint for each in differences}) == 62
    table = pair_table(pair, differences)
    assert table.row_count == 12
    assert table.caption == "the 12 of 62 joints that differ most"
    peaks = np.abs(pair.difference("torques")).max(axis=0) / robot.torque_limits
    most = {robot.names[k] for k in np.argsort(-peaks)[:12]}
    assert set(table.columns[0].cells) == most
