"""What explains the differences of torques that `compare` finds, and identification.

In: runs of a robot. Out: the explainer `torques` and the command `identify`.
Open first: `explain.py` for what is told, `explain_search.py` for how it is found,
`torque_residuals.py` for the model, `identify.py` for friction, payload and offsets.
"""
