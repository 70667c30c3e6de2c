"""Navigation mathematics of RIINS. Nothing here knows ROS.

Conventions, the same in every algorithm of the workspace (the ROS boundary differs, see the last column of docs):

navigation frame
    n = NED, local geodetic, WGS-84. At the ROS boundary ENU (REP-103); a topic that carries NED has a frame id ending in `_ned`.
body frame
    b = FRD: x forward, y starboard, z down. At the ROS boundary FLU `base_link`.
attitude
    `C_nb` turns b into n: v_n = C_nb v_b. Quaternions are scalar-last. Roll, pitch, heading; heading clockwise from true north, 0 .. 2 pi.
position
    latitude, longitude [rad], ellipsoidal height [m]. Degrees in NavSatFix and NavState.
time
    integer nanoseconds of measurement validity at the boundary, never of arrival; float64 seconds since the run's first stamp inside.
units
    SI. Units of data sheets (deg/h, deg/sqrt(h), ug, ppm, kn, arcmin) only in YAML, where the key carries the unit.
inertial errors
    bias = measured - true. IEEE names: bias, bias instability, angle random walk, velocity random walk, scale factor, misalignment.
navigation error
    computed minus true for position and velocity; computed C_nb = (I - [phi x]) true C_nb; phi' = -w_in x phi + d w_in - C_nb b_g;
    dv' = f x phi + C_nb b_a + ...; computed - true heading = -phi_D; correction C_nb <- (I + [phi x]) C_nb.
IMU sample
    rate and force are the integrated increment / dt, the mean over (stamp - dt, stamp]; the stamp is the end of the interval.
covariance
    symmetric, full, ordered as the state's IntEnum.
innovation
    z = measured - predicted, standardized once by `kalman.update`.
"""
