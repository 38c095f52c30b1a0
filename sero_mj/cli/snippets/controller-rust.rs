// A controller for sero-mj as a shared library:
//
//     rustc -O --crate-type cdylib controller.rs -o controller.so
//     sero-mj simulate controller.toml          (sero-mj new --snippet controller-rust --scene prints it)
use std::os::raw::{c_double, c_int};

/// State of a robot with n joints. Units: rad and Nm; m and N for prismatic joints. The pointers
/// are the same in every step.
#[repr(C)]
pub struct Robot {
    n: c_int,
    is_first: c_int,     // 1 in the first step of a run
    time: c_double,      // s since the start
    timestep: c_double,  // s between two steps
    angles: *const c_double, // measured
    velocities: *const c_double,
    torques: *const c_double,
    target_angles: *const c_double, // desired motion
    target_velocities: *const c_double,
    target_accelerations: *const c_double,
    gravity: *const c_double, // torques that hold the robot; null if gravity = false
    torques_out: *mut c_double, // output; contains the torques of the last step
}

/// Joint impedance: stiffness and damping about the target, plus gravity compensation.
///
/// # Safety
/// `robot` must point to a valid `Robot` whose arrays have n elements.
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
