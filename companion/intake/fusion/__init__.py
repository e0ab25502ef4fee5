"""Several inertial units as one: resampled, rid of lever arms, weighed, judged. Pure."""
