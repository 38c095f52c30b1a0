// A controller for sero-mj as a shared library:
//
//     rustc -O --crate-type cdylib controller.rs -o controller.so
//     sero-mj simulate controller.toml          (printed by sero-mj new --snippet controller-rust --scene)
use std::os::raw::{c_double, c_int};

/// The state of a robot with n joints (rad, Nm; m, N for prismatic joints). The arrays are the same in every step.
#[repr(C)]
pub struct Robot {
    n: c_int,
    is_first: c_int,     // 1 in the first step of a run
    time: c_double,      // s since the start
    timestep: c_double,  // s between two steps
    angles: *const c_double, // measured
    velocities: *const c_double,
    torques: *const c_double,
    target_angles: *const c_double, // targets
    target_velocities: *const c_double,
    target_accelerations: *const c_double,
    gravity: *const c_double, // torques that hold the robot; null with gravity = false
    torques_out: *mut c_double, // output; contains the values of the last step
}

/// Joint impedance: a spring and a damper at the target, and gravity compensation.
///
/// # Safety
/// `robot` points to a robot whose arrays have n numbers.
#[no_mangle]
pub unsafe extern "C" fn control(robot: *mut Robot) {
    let robot = &mut *robot;
    let (stiffness, damping) = (800.0, 40.0); // Nm/rad, Nm s/rad
    for i in 0..robot.n as usize {
        *robot.torques_out.add(i) = stiffness * (*robot.target_angles.add(i) - *robot.angles.add(i))
            + damping * (*robot.target_velocities.add(i) - *robot.velocities.add(i))
            + *robot.gravity.add(i);
    }
}
