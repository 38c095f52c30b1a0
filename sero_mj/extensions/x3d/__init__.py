"""Scenes of the SeRo-Viewer: X3D in its classic encoding, VRML97, and the paper's protos.

In: files .x3d, .x3dv, .wrl. Out: the importer `x3d`, meshes of links, and formats of `export`.
Open first: `reader.py` for scenes, `wrl.py` for meshes, `writer.py` for the export.
"""
