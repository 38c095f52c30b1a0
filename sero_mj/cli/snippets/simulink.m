% Code of a MATLAB Function block. Connect its output to a `UDP Send` block (HOST "127.0.0.1", PORT 32000).
function bytes = sero_packet(count, time, angles, torques, commanded) %#codegen
JOINTS = 7; % number of angles [rad], torques [Nm] and commanded torques [Nm]
values = [time; reshape(angles, JOINTS, 1); reshape(torques, JOINTS, 1); reshape(commanded, JOINTS, 1)];
bytes = [typecast(uint32(count), 'uint8'), typecast(double(values'), 'uint8')];
end

% In MATLAB, without Simulink:
%   port = udpport;
%   write(port, sero_packet(k, posixtime(datetime("now")), q, tau, tau_d), "uint8", "127.0.0.1", 32000)
