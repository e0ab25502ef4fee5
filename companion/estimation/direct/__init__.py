"""The direct kinematic filter: the trajectory is the state, every IMU is a measurement.

No inertial mechanisation. A point mass whose acceleration and angular rate wander carries the
state; gyros and accelerometers of N units, GNSS, barometer, compass and attitude are measurements.
It serves where a strapdown filter cannot: an IMU of a few hertz, or several of which one fails.

States, error = truth − estimate (15 + 12 N, then slow errors of aids):

- position (NED, m), velocity and acceleration of the first IMU over the ground (NED);
- attitude, ψ in body axes with C_true = C exp([ψ×]); rate of the body against n, body axes;
- of each IMU gyro bias, accelerometer bias, gyro scale, accelerometer scale.

Yu et al. 2018 (equations 12-44) with velocity and acceleration in n where the paper has them in
body axes: the same trajectory model, linear in these. docs/yu-2018.md says where we read what.
"""
