"""Reads and writes scenes of the SeRo-Viewer in X3D's classic encoding, with the paper's protos.

In: .x3d, .x3dv and .wrl files. Out: the importer `x3d`, meshes of links, and formats of `export`.
Open first: `reader.py` for scenes, `wrl.py` for meshes, `writer.py` for the export.
"""
