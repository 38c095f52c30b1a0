"""Write a controller: any object with a method `torques` controls a simulated robot."""

import numpy as np
from PIL import Image
import sero_mj

STIFFNESS, DAMPING = 200.0, 20.0  # Nm/rad, Nm s/rad


class Spring:
    """A spring and a damper per joint, without gravity compensation."""

    def torques(self, sensed, target, out) -> None:
        out[:] = (
            STIFFNESS * (target.angles - sensed.angles) - DAMPING * sensed.velocities
        )


home = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0])
lwr = sero_mj.SerialRobot.from_model("lwr", joint_angles=home, show_arrows=True)
scene = sero_mj.Scene(robots=[lwr], doubles=[sero_mj.Double(name="target", of="lwr")])
scenario = sero_mj.Scenario(scene, controllers={"lwr": Spring()}, duration=2.0)
simulation = sero_mj.Simulation(scenario)
for _ in simulation.run():
    pass

angles = simulation.log.of("lwr", "joint_angles")[-1]
print("deflection by gravity:", np.rad2deg(angles - home).round(1), "degrees")

world = sero_mj.World(scene)
data = world.make_data()
world.set_input(data, "lwr.joint_angles", angles)
world.set_input(data, "lwr.torques", simulation.log.of("lwr", "torques")[-1])
world.set_input(data, "target.joint_angles", home)
sero_mj.Placer(world).place(data)
with sero_mj.HeadlessRenderer(world, 640, 400) as renderer:
    Image.fromarray(renderer.render(data)).save("02_controller.webp")
