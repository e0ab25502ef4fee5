"""u-blox receivers: UBX frames, raw measurements, navigation messages, the receiver's own fix.

The codec is our own beside pyubx2, which is the judge in its tests: an epoch of 72 signals costs
pyubx2 8 ms, a tenth of a millisecond here, and a live loop needs a framer that never blocks.
"""
