"""Simulate a scenario: joint impedance control holds a pose against a push."""

import numpy as np
import sero_mj

scenario = sero_mj.read_scenario("impedance_push")
simulation = sero_mj.Simulation(scenario)
for _ in simulation.run():
    pass  # each iteration has simulated another part of the run

torques = simulation.log.of("lwr", "torques")  # Nm, shape (steps + 1, 7)
print("largest torques:", np.abs(torques).max(axis=0).round(1), "Nm")
for outcome in simulation.outcomes():
    print("passed" if outcome.holds else "failed", outcome.name)

# `load_scene` shows a scenario as a scene that simulates it.
scene = sero_mj.load_scene("impedance_push")
sero_mj.render_image(scene, "01_simulate.webp", at=2.5, size=(640, 400))
