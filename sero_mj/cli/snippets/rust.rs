//! Call `sero.send(time, &angles, &torques, &commanded)` in your control loop. It does not block.
use std::net::UdpSocket;

const JOINTS: usize = 7;
const TO: &str = "127.0.0.1:32000"; // the computer that runs sero-mj

pub struct SeroMj {
    socket: UdpSocket,
    count: u32,
}

impl SeroMj {
    pub fn new() -> std::io::Result<Self> {
        let socket = UdpSocket::bind("0.0.0.0:0")?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, count: 0 })
    }

    /// Sends the time in s, angles in rad, torques in Nm.
    pub fn send(
        &mut self,
        time: f64,
        angles: &[f64; JOINTS],
        torques: &[f64; JOINTS],
        commanded: &[f64; JOINTS],
    ) {
        self.count = self.count.wrapping_add(1);
        let mut packet = [0u8; 12 + 24 * JOINTS];
        packet[..4].copy_from_slice(&self.count.to_le_bytes());
        packet[4..12].copy_from_slice(&time.to_le_bytes());
        let values = angles.iter().chain(torques).chain(commanded);
        for (place, value) in packet[12..].chunks_exact_mut(8).zip(values) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        let _ = self.socket.send_to(&packet, TO); // ignore the error if sero-mj is not running
    }
}
