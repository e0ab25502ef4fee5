"""What leaves the process: zenoh for subscribers, MAVLink for ground stations and autopilots.

Encoders are pure functions of solutions; senders beside them own the sockets. Nothing here ever
makes the estimator wait: what cannot be sent at once is dropped, and a link that is gone is opened
again behind its back.
"""
