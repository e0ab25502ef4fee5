"""Navigation messages as satellites send them: bits in, rows of :mod:`companion.gnss.orbit` out.

Weeks in messages turn over (1024, 4096, 8192): a time of reference is taken for the one nearest to
the time of reception, and a message whose week does not fit that is refused.
"""
