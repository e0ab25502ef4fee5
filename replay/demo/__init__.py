"""The whole system with no hardware: simulated vehicle, companion and subscriber as processes.

``processes`` starts and ends them, ``subscriber`` is the one that listens to zenoh, ``figures``
makes numbers of what they left, ``flight`` is the course of it all.
"""
