"""Capabilities that a lab may not need, one folder each, with everything of it.

In: the core, which never imports or names an extension. Out: entry points in `pyproject.toml`, by
which the core finds what an extension adds. Deleting a folder and its entry points leaves a working
product. Tests are in `tests/extensions/NAME`.
"""
