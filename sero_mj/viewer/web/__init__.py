"""The live page: the player of `viewer/player` in browsers, fed by a server of this process.

In: a world that is shown, and its clock. Out: a page on a port; clicks and keys, as in a window.
Open first: `host.py`. `page_state.py` and `page_panels.py` put what browsers show into
`sections.py`, `page_input.py` takes their messages, `browsers.py` and `server.py` talk to them,
and `guard.py` refuses strangers. `start_host.py` serves the start page.
"""
