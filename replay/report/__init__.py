"""A run as one self-contained page: what happened, whether it was good, and why not.

run log → :class:`~replay.report.run_view.RunView` → panels, track, verdict → HTML
"""
