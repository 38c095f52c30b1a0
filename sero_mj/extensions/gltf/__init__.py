"""Scenes and runs as glTF animations (.glb), for programs that know nothing about robots.

In: a captured run. Out: the format `glb` of `sero-mj export`.
Open first: `export.py`.
"""
