"""The web page: MuJoCo Studio's `WebViewer` with plugins of sero-mj.

In: a world that is shown, and its clock. Out: a page on a port; clicks and keys, as in a window.
Open first: `host.py`; `studio.py` adapts Studio, `studio_controls.py` takes its input,
`studio_decor.py` gives it geoms, `page_windows.py` are its windows, `guard.py` says who may look;
`start_host.py` serves the start page, `uploads.py` takes files that are dropped on a page.
"""
