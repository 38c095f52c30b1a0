"""A live web page. Browsers display it with the player of `viewer/player`.

In: a mirror and a clock. Out: a page on a port, and the user's actions as in a window.
Open first: `host.py`. `page_state.py` and `page_panels.py` write the displayed state to
`sections.py`. `page_input.py` handles messages of browsers. `browsers.py` and `server.py`
communicate with them. `guard.py` controls access. `start_host.py` serves the start page.
"""
