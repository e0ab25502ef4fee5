"""``companion watch``: what vehicles publish, as one picture in the terminal.

messages → :class:`~companion.watch.picture.VehiclePicture` (pure) → :mod:`~companion.watch.view`
"""
