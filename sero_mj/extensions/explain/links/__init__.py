"""Identifies all links, drives and sensors of a robot from a recording.

Open `identify_links` first. `equations` contains the model, `consistent_links` the conditions on
masses and inertias, and `report` and `robot_files` write the results.
"""
