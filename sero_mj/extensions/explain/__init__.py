"""Explanations of torque differences for `compare`, and identification of robots.

In: runs of a robot. Out: the explainer `torques` and the command `identify`.
Open first: `explain.py` for the kinds of faults. `explain_search.py` searches for them,
`torque_residuals.py` has the model, and `identify.py` estimates friction, payload and offsets.
`links` identifies whole robots.
"""
