"""``companion watch --web``: what vehicles publish, as one page in a browser.

messages → :class:`~companion.watch.web.model.PageModel` (pure) → :mod:`~companion.watch.web.server`
→ server-sent events → ``assets/live.js``

The server keeps what a page needs to begin anew: a page that was closed, slept or lost its
connection gets the last minutes again. Everything that is kept has a limit.
"""
