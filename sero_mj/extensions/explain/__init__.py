"""Explanations of torque differences for `compare`, and identification of robots.

Input: runs of a robot. Output: the explainer `torques` and the command `identify`.
Start with `explain.py` for the kinds of faults. `explain_search.py` searches for them,
`torque_residuals.py` has the model, and `identify.py` estimates friction, payload and offsets.
"""
