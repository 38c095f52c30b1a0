"""Scenarios: simulated robots with controllers, sensors, disturbances and faults.

In: a scenario: a scene, controllers, targets, disturbances, faults, expectations. Out: a `RunLog`,
and whether everything held.
Open first: `scenario.py` (what can be declared), `simulation.py` (the loop), `plant.py` (the
robots), `control/torque_loop.py` (the torque loop of joints); `endless_run.py` and
`live_control.py` are for robots that are steered while they run.
"""
