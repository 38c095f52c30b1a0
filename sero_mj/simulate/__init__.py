"""Scenarios: simulated robots with controllers, sensors, disturbances and faults.

In: a scenario with a scene, controllers, targets, disturbances, faults and expectations. Out: a
`RunLog`, and the outcomes of the expectations.
Open first: `scenario.py` (declarations), `simulation.py` (the loop), `plant.py` (the robots),
`control/torque_loop.py` (joint torque control). `endless_run.py` and `live_control.py` are for
robots that are moved and tuned during the simulation.
"""
