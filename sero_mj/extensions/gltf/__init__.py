"""Exports scenes and runs as glTF animations (.glb) for programs that do not support robots.

In: a captured run. Out: the format `glb` of `sero-mj export`.
Open first: `export.py`.
"""
