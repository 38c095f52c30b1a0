"""The live page: the player of `viewer/player` in browsers, fed by a server of this process.

In: a world that is shown, and its clock. Out: a page on a port; clicks and keys, as in a window.
Open first: `host.py`; what browsers are sent is put together by `page_state.py` (what is drawn) and
`page_panels.py`, into `sections.py`; `page_input.py` takes what they say; `browsers.py` knows who
looks on, `server.py` serves and `guard.py` says to whom. `start_host.py` serves the start page.
"""
