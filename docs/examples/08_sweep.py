"""Run variants of a scenario: how far does the same push move the flange?"""

import numpy as np
from PIL import Image
from sero_mj import (
    Double,
    HeadlessRenderer,
    Placer,
    Scene,
    Simulation,
    World,
    read_scenario,
)

poses = {}
for stiffness in (100, 200, 400, 800):  # Nm/rad
    overrides = {"controllers.lwr.stiffness": stiffness}
    simulation = Simulation(read_scenario("impedance_push", overrides))
    for _ in simulation.run():
        pass
    angles = simulation.log.of("lwr", "joint_angles")
    moved = np.abs(angles - angles[0]).max(axis=1)
    poses[stiffness] = angles[moved.argmax()]
    print(f"{stiffness:4} Nm/rad: deflection {np.rad2deg(moved.max()):5.1f} degrees")

# On a cluster or on all cores: sero-mj sweep impedance_push --vary ...
robot = simulation.scenario.scene.robots["lwr"]
doubles = [Double(name=f"k{stiffness}", of="lwr") for stiffness in poses]
world = World(Scene(robots=[robot], doubles=doubles))
data = world.make_data()
world.set_input(data, "lwr.joint_angles", robot.joint_angles)
for stiffness, pose in poses.items():
    world.set_input(data, f"k{stiffness}.joint_angles", pose)
Placer(world).place(data)
with HeadlessRenderer(world, 640, 400) as renderer:
    renderer.toggles.cards[:] = False
    Image.fromarray(renderer.render(data)).save("08_sweep.webp")
