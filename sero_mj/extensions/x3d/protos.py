"""Maps fields and events of the paper's X3D protos (Fig. 3 and 5) to keys of scene files."""

from __future__ import annotations

from pathlib import Path

from .vrml_nodes import Node

OWN_NODES = ("SerialRobot", "UdpReceiver", "ShmReader")
PAPER_CONVENTION = "craig"
# For each field of the paper's protos: X3D type and key in scene files.
ROBOT_FIELDS = {
    "dhParams": ("MFVec4f", "dh_params"),
    "directory": ("SFString", "directory"),
    "filenames": ("MFString", "filenames"),
    "baseFrame": ("SFMatrix4f", "base_frame"),
    "flangeFrame": ("SFMatrix4f", "flange_frame"),
    "jointAngles": ("MFFloat", "joint_angles"),
    "enableTouchSensor": ("SFBool", "enable_touch_sensor"),
    "offsetsToCenterOfJoints": ("MFVec3f", "offsets_to_center_of_joints"),
    "showAxes": ("SFBool", "show_axes"),
    "axesSize": ("SFFloat", "axes_size"),
    "axesTransparency": ("SFFloat", "axes_transparency"),
    "showArrows": ("SFBool", "show_arrows"),
    "arrowRadius": ("SFFloat", "arrow_radius"),
    "arrowWidthScale": ("SFFloat", "arrow_width_scale"),
    "showBillboards": ("SFBool", "show_billboards"),
    "billboardScale": ("SFFloat", "billboard_scale"),
}
UDP_FIELDS = {
    "structure": ("SFString", "structure"),
    "udpport": ("SFInt32", "port"),
    "bufferSize": ("SFInt32", "buffer_size"),
    "isDouble": ("SFBool", "double"),
    "columnMajor": ("SFBool", "column_major"),
    "onlyLatestPacket": ("SFBool", "only_latest_packet"),
    "scale": ("SFFloat", "scale"),
    "debuglevel": ("SFInt32", "debug_level"),
}
# The paper lists no fields of `ShmReader`. Here, it has most fields of `UdpReceiver`, and more.
SHM_FIELDS = {
    **{name: each for name, each in UDP_FIELDS.items() if name not in ("udpport", "bufferSize")},
    "block": ("SFString", "block"),
    "lock": ("SFString", "lock"),
    "offset": ("SFInt32", "offset"),
}
# Fields that sero-mj adds have the keys of scene files in camel case.
MORE_ROBOT_FIELDS = {
    "dhConvention": ("SFString", "dh_convention"),
    "jointNames": ("MFString", "joint_names"),
    "jointTypes": ("MFString", "joint_types"),
    "positionLimits": ("MFVec2f", "position_limits"),
    "velocityLimits": ("MFFloat", "velocity_limits"),
    "torqueLimits": ("MFFloat", "torque_limits"),
}
MORE_SOURCE_FIELDS = {
    "sequence": ("SFString", "sequence"),
    "time": ("SFString", "time"),
    "timeScale": ("SFFloat", "time_scale"),
    "alignment": ("SFInt32", "alignment"),
}
MORE_UDP_FIELDS = {
    **MORE_SOURCE_FIELDS,
    "host": ("SFString", "host"),
    "interface": ("SFString", "interface"),
    "sender": ("MFString", "sender"),
}
# ROUTEs can have these inputs and outputs of a robot.
ROBOT_INPUTS = {
    "jointAngles": "joint_angles",
    "torques": "torques",
    "billboardValues": "billboard_values",
    "baseFrame": "base_frame",
    "showAxes": "show_axes",
    "showArrows": "show_arrows",
    "showBillboards": "show_billboards",
}
FLANGE = "fwdKinFromBaseToFlange"
ROBOT_OUTPUTS = {"jointAngles": "joint_angles", FLANGE: "fwd_kin_base_to_flange"}
SOURCE_EVENTS = {"receiving": "receiving", "receiveTrigger": "receive_trigger"}


def own_kind(node: Node) -> str:
    """Returns the name of the paper's proto that a node instantiates, or an empty string.

    An EXTERNPROTO may have another name than the PROTO at its URL, so both names are compared.
    """
    if node.kind in OWN_NODES:
        return node.kind
    for url in () if node.proto is None else node.proto.urls:
        file, _, fragment = url.partition("#")
        name = fragment or Path(file).stem.removeprefix("PROTO_")
        for kind in OWN_NODES:
            if name.lower() == kind.lower():
                return kind
    return ""
