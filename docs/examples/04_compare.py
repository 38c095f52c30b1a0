"""Compare two runs: the same push with two stiffnesses."""

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

logs = []
for stiffness in (800.0, 200.0):  # Nm/rad
    overrides = {"controllers.lwr.stiffness": stiffness, "run.duration": 5.0}
    simulation = Simulation(read_scenario("impedance_push", overrides))
    for _ in simulation.run():
        pass
    logs.append(simulation.log)

stiff, soft = (log.of("lwr", "joint_angles") for log in logs)
difference = np.abs(soft - stiff)
peak = int(difference.max(axis=1).argmax())
print("largest difference:", np.rad2deg(difference.max(axis=0)).round(2), "degrees")
print(f"at {logs[0].times[peak]:.2f} s")

robot = simulation.scenario.scene.robots["lwr"]
world = World(Scene(robots=[robot], doubles=[Double(name="soft", of="lwr")]))
data = world.make_data()
world.set_input(data, "lwr.joint_angles", stiff[peak])
world.set_input(data, "lwr.torques", logs[0].of("lwr", "torques")[peak])
world.set_input(data, "soft.joint_angles", soft[peak])
Placer(world).place(data)
with HeadlessRenderer(world, 640, 400) as renderer:
    Image.fromarray(renderer.render(data)).save("04_compare.webp")
