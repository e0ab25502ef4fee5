"""Many logs: replayed, smoothed, evaluated and reported on all cores or on a Dask cluster.

listing → :mod:`~replay.batch.scheduling` (Dask: where each log goes, a few at a time)
→ :mod:`~replay.batch.worker` (is it done already? else into a process of its own)
→ :mod:`~replay.batch.child` → :mod:`~replay.batch.one_log` (the work)
→ outcomes, small rows → :mod:`~replay.batch.outliers` → summary page and CSV

What is done lies on the disk, one file a log, named after everything that decided it
(:mod:`~replay.batch.store`): a batch that was interrupted takes up where it was.
"""
