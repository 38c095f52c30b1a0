"""Exports scenes and runs as glTF animations (.glb), for programs without support for robots.

In: a captured run. Out: the format `glb` of `sero-mj export`.
Open first: `export.py`.
"""
