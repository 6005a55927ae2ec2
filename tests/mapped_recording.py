"""The terrain map of a recording that holds poses of its depth camera."""

from stridetwin.estimators.terrain_map import TerrainMap
from stridetwin.estimators.terrain_map.depth_camera import depth_calibration
from stridetwin.outputs.chosen_poses import find_pose_topic
from stridetwin.outputs.feeding import instance_for
from stridetwin.outputs.pose_feed import replay
from stridetwin.outputs.terrain.kind import TerrainMaps
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.trajectory import Trajectory


def map_recording(recording: Recording) -> TerrainMap:
    topic, frame = find_pose_topic(recording, depth_calibration(recording.rig))
    block = recording.block(topic)
    p, q = block.columns["p_frame_in_world"], block.columns["q_world_frame"]
    poses = Trajectory(t_ns=block.t_ns, p_frame_in_world=p, q_world_frame=q)
    instance = instance_for(TerrainMap, recording).with_poses_of(frame)
    ((_, (output,)),) = replay([(TerrainMaps(), instance)], recording, poses)
    return output.estimates.terrain_map
