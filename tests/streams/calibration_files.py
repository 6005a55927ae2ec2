"""Calibration files of other tools for one known camera and IMU, written as the tools write them."""

import json

import numpy as np
from scipy.spatial.transform import Rotation

SIZE = (752, 480)
FOCAL, CENTRE = (458.654, 457.296), (367.215, 248.375)
RADTAN = (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)
NOISE = (1.6968e-4, 1.9393e-5, 2.0e-3, 3.0e-3)
"""Noise density and random walk of the gyroscope, then of the accelerometer."""
SHIFT_S = 0.0042


def rigid(rotvec, position):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    T[:3, 3] = position
    return T


T_IMU_CAM = rigid((0.4, -1.1, 1.3), (-0.0216, -0.0647, 0.0098))
"""Pose of the camera in the IMU's frame."""
T_C1_C2 = rigid((0.002, -0.01, 0.001), (0.11, -0.0004, 0.0009))
"""Pose of the second camera in the first one's frame."""


def opencv_matrix(T, indent="  "):
    flat = ", ".join(f"{value:.15g}" for value in np.asarray(T).ravel())
    rows, cols = np.shape(T)
    return f"!!opencv-matrix\n{indent}rows: {rows}\n{indent}cols: {cols}\n{indent}dt: d\n{indent}data: [{flat}]\n"


def rows(T):
    return "\n".join(f"    - [{', '.join(f'{value:.15g}' for value in row)}]" for row in T) + "\n"


def kalibr_camera(name="cam0", *, lens="pinhole", intrinsics=(*FOCAL, *CENTRE), model="radtan", coefficients=RADTAN):
    return (
        f"{name}:\n  camera_model: {lens}\n  intrinsics: {list(intrinsics)}\n  distortion_model: {model}\n"
        f"  distortion_coeffs: {list(coefficients)}\n  resolution: [{SIZE[0]}, {SIZE[1]}]\n"
        f"  rostopic: /{name}/image_raw\n"
    )


def kalibr_imu(name="imu0"):
    gyro, gyro_walk, accel, accel_walk = NOISE
    return (
        f"{name}:\n  accelerometer_noise_density: {accel:.4e}\n  accelerometer_random_walk: {accel_walk:.4e}\n"
        f"  gyroscope_noise_density: {gyro:.4e}\n  gyroscope_random_walk: {gyro_walk:.4e}\n"
        f"  rostopic: /{name}\n  update_rate: 200.0\n"
    )


def write_kalibr(folder):
    """`camchain-imucam.yaml` and `imu.yaml` in one."""
    shift = f"  timeshift_cam_imu: {SHIFT_S}\n"
    first = kalibr_camera() + "  cam_overlaps: [1]\n  T_cam_imu:\n" + rows(np.linalg.inv(T_IMU_CAM)) + shift
    second = kalibr_camera("cam1") + "  cam_overlaps: [0]\n  T_cn_cnm1:\n" + rows(np.linalg.inv(T_C1_C2)) + shift
    imu = kalibr_imu() + "  T_i_b:\n" + rows(np.eye(4)) + "  model: calibrated\n  time_offset: 0.0\n"
    (folder / "camchain-imucam.yaml").write_text(first + second + imu)
    return folder / "camchain-imucam.yaml"


def write_openvins(folder):
    """The three files of a configuration of OpenVINS."""
    (folder / "estimator_config.yaml").write_text(
        '%YAML:1.0 # need to specify the file type at the top!\n\nverbosity: "INFO"\nmax_clones: 11\n'
        'relative_config_imu: "kalibr_imu_chain.yaml"\nrelative_config_imucam: "kalibr_imucam_chain.yaml"\n'
    )
    models = "".join(f"  {key}:\n{rows(np.eye(3))}" for key in ("Tw", "R_IMUtoGYRO", "Ta", "R_IMUtoACC"))
    models += f"  Tg:\n{rows(np.zeros((3, 3)))}"
    (folder / "kalibr_imu_chain.yaml").write_text(
        "%YAML:1.0\n\n"
        + kalibr_imu()
        + "  T_i_b:\n"
        + rows(np.eye(4))
        + '  time_offset: 0.0\n  model: "kalibr"\n'
        + models
    )
    poses = {"cam0": T_IMU_CAM, "cam1": T_IMU_CAM @ T_C1_C2}
    sections = [
        kalibr_camera(name) + f"  T_imu_cam: # pose\n{rows(T)}  cam_overlaps: [{i}]\n  timeshift_cam_imu: {SHIFT_S}\n"
        for i, (name, T) in enumerate(poses.items())
    ]
    (folder / "kalibr_imucam_chain.yaml").write_text("%YAML:1.0\n\n" + "\n".join(sections))
    return folder / "estimator_config.yaml"


def camodocal(model="PINHOLE", body=""):
    body = body or (
        "distortion_parameters:\n"
        + "".join(f"   {key}: {value:.10g}\n" for key, value in zip(("k1", "k2", "p1", "p2"), RADTAN, strict=True))
        + "projection_parameters:\n"
        + "".join(f"   {k}: {v:.10g}\n" for k, v in zip(("fx", "fy", "cx", "cy"), (*FOCAL, *CENTRE), strict=True))
    )
    size = f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\n"
    return f"%YAML:1.0\n---\nmodel_type: {model}\ncamera_name: camera\n{size}{body}"


def write_vins_fusion(folder):
    """A configuration of VINS-Fusion with the files of its two cameras; it has no rate of the IMU."""
    gyro, gyro_walk, accel, accel_walk = NOISE
    (folder / "cam0_pinhole.yaml").write_text(camodocal())
    (folder / "cam1_pinhole.yaml").write_text(camodocal())
    (folder / "euroc_stereo_imu_config.yaml").write_text(
        "%YAML:1.0\n\n#common parameters\nimu: 1         \nnum_of_cam: 2  \n\n"
        'imu_topic: "/imu0"\nimage0_topic: "/cam0/image_raw"\nimage1_topic: "/cam1/image_raw"\n'
        'output_path: "~/output/"\n'
        'cam0_calib: "cam0_pinhole.yaml"\ncam1_calib: "cam1_pinhole.yaml"\n'
        f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\n\nestimate_extrinsic: 0\n"
        f"body_T_cam0: {opencv_matrix(T_IMU_CAM, '   ')}\nbody_T_cam1: {opencv_matrix(T_IMU_CAM @ T_C1_C2, '   ')}\n"
        f"max_cnt: 150\t# max feature number\nacc_n: {accel}          # noise\ngyr_n: {gyro}\nacc_w: {accel_walk}\n"
        f"gyr_w: {gyro_walk}\ng_norm: 9.81007\nestimate_td: 0\ntd: {SHIFT_S}\n"
    )
    return folder / "euroc_stereo_imu_config.yaml"


def orb_camera(prefix):
    values = {**dict(zip(("fx", "fy", "cx", "cy"), (*FOCAL, *CENTRE), strict=True))}
    values |= dict(zip(("k1", "k2", "p1", "p2"), RADTAN, strict=True))
    return "".join(f"{prefix}.{key}: {value:.10g}\n" for key, value in values.items())


def orb_imu():
    gyro, gyro_walk, accel, accel_walk = NOISE
    return (
        f"IMU.NoiseGyro: {gyro:.4e} # comment\nIMU.NoiseAcc: {accel:.4e}\nIMU.GyroWalk: {gyro_walk:.4e}\n"
        f"IMU.AccWalk: {accel_walk:.4e}\nIMU.Frequency: 200.0\n"
    )


def write_orb_slam3(folder):
    """Settings of ORB-SLAM3 in version 1.0."""
    (folder / "EuRoC.yaml").write_text(
        '%YAML:1.0\n\n#----\nFile.version: "1.0"\n\nCamera.type: "PinHole"\n\n'
        + orb_camera("Camera1")
        + orb_camera("Camera2")
        + f"\nCamera.width: {SIZE[0]}\nCamera.height: {SIZE[1]}\nCamera.fps: 20\nCamera.RGB: 1\n"
        + f"Stereo.ThDepth: 60.0\nStereo.T_c1_c2: {opencv_matrix(T_C1_C2)}\nIMU.T_b_c1: {opencv_matrix(T_IMU_CAM)}\n"
        + orb_imu()
        + "ORBextractor.nFeatures: 1200\nViewer.KeyFrameSize: 0.05\n"
    )
    return folder / "EuRoC.yaml"


def write_orb_slam3_old(folder):
    """Settings of ORB-SLAM3 before version 1.0, for one camera."""
    (folder / "EuRoC_old.yaml").write_text(
        '%YAML:1.0\nCamera.type: "PinHole"\n'
        + orb_camera("Camera")
        + f"Camera.width: {SIZE[0]}\nCamera.height: {SIZE[1]}\nTbc: {opencv_matrix(T_IMU_CAM, '   ')}\n"
        + orb_imu()
    )
    return folder / "EuRoC_old.yaml"


def write_basalt(folder):
    """Basalt's JSON, indented by tabs as some tools write it."""
    gyro, gyro_walk, accel, accel_walk = NOISE

    def pose(T):
        keys = ("px", "py", "pz", "qx", "qy", "qz", "qw")
        return dict(zip(keys, [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()], strict=True))

    lens = dict(zip(("fx", "fy", "cx", "cy"), (*FOCAL, *CENTRE), strict=True))
    lens |= dict(zip(("k1", "k2", "p1", "p2"), RADTAN, strict=True)) | dict.fromkeys(
        ("k3", "k4", "k5", "k6", "rpmax"), 0.0
    )
    value = {
        "T_imu_cam": [pose(T_IMU_CAM), pose(T_IMU_CAM @ T_C1_C2)],
        "intrinsics": [{"camera_type": "pinhole-radtan8", "intrinsics": lens}] * 2,
        "resolution": [list(SIZE)] * 2,
        "vignette": [],
        "calib_accel_bias": [0.0] * 9,
        "calib_gyro_bias": [0.0] * 12,
        "imu_update_rate": 200.0,
        "accel_noise_std": [accel] * 3,
        "gyro_noise_std": [gyro] * 3,
        "accel_bias_std": [accel_walk] * 3,
        "gyro_bias_std": [gyro_walk] * 3,
        "cam_time_offset_ns": round(SHIFT_S * 1e9),
    }
    (folder / "calibration.json").write_text(json.dumps({"value0": value}, indent="\t"))
    return folder / "calibration.json"


def rs_paragraph(stream, size, focal, model="Brown Conrady", coefficients=(0, 0, 0, 0, 0)):
    return (
        f' Intrinsic of "{stream}" / {size[0]}x{size[1]} / {{YUYV/RGB8/BGR8/RGBA8/BGRA8/Y8}}\n'
        f"  Width:      \t{size[0]}\n  Height:     \t{size[1]}\n"
        f"  PPX:        \t{CENTRE[0]}\n  PPY:        \t{CENTRE[1]}\n"
        f"  Fx:         \t{focal[0]}\n  Fy:         \t{focal[1]}\n  Distortion: \t{model}\n"
        "  Coeffs:     \t" + "  \t".join(map(str, coefficients)) + "  \n  FOV (deg):  \t69.54 x 42.75\n\n"
    )


def rs_extrinsic(start, end, T):
    lines = "".join("   " + "".join(f"{value:<17.9g}" for value in row) + "\n" for row in T[:3, :3])
    position = "  ".join(f"{value:.15g}" for value in T[:3, 3])
    names = f'Extrinsic from "{start}"\t  To\t  "{end}" :\n'
    return f"{names} Rotation Matrix:\n{lines}\n Translation Vector: {position}  \n\n"


def write_realsense_text(folder):
    """The output of `rs-enumerate-devices -c`; depth is where the transforms meet."""
    T_depth_color = rigid((0.003, -0.002, 0.001), (0.0147, 0.0002, 0.0003))
    T_gyro_depth = T_IMU_CAM @ np.linalg.inv(T_depth_color)
    text = (
        "Device info: \n    Name                          : \tIntel RealSense D435I\n\nIntrinsic Parameters:\n\n"
        + rs_paragraph("Depth", (640, 480), (382.0, 382.0))
        + rs_paragraph("Color", (640, 480), (610.0, 610.0))
        + rs_paragraph("Color", SIZE, FOCAL, "Inverse Brown Conrady", (*RADTAN, 0))
        + 'Motion Intrinsic Parameters:\n\n Motion Intrinsic of "Gyro"\t  MOTION_XYZ32F\n'
        + "  Bias Variances:  \t0  \t0  \t0  \n\n"
        + "Extrinsic Parameters:\n\n"
        + rs_extrinsic("Color", "Depth", T_depth_color)
        + rs_extrinsic("Depth", "Gyro", T_gyro_depth)
    )
    (folder / "rs.txt").write_text(text)
    return folder / "rs.txt"


def write_realsense_json(folder):
    """JSON with librealsense's fields; rotations are nine numbers by columns."""
    lens = {"width": SIZE[0], "height": SIZE[1], "ppx": CENTRE[0], "ppy": CENTRE[1], "fx": FOCAL[0], "fy": FOCAL[1]}
    T = np.linalg.inv(T_IMU_CAM)
    document = {
        "serial": "123",
        "color": lens | {"model": "distortion.inverse_brown_conrady", "coeffs": [*RADTAN, 0.0]},
        "extrinsics": {"gyro_to_color": {"rotation": T[:3, :3].T.ravel().tolist(), "translation": T[:3, 3].tolist()}},
    }
    (folder / "rs.json").write_text(json.dumps(document))
    return folder / "rs.json"


def write_euroc_sensor(folder):
    """A single `sensor.yaml` of the EuRoC layout."""
    (folder / "sensor.yaml").write_text(
        "%YAML:1.0\nsensor_type: camera\ncomment: VI-Sensor cam0 (MT9M034)\n"
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: {T_IMU_CAM.ravel().tolist()}\nrate_hz: 20\n"
        f"resolution: [{SIZE[0]}, {SIZE[1]}]\ncamera_model: pinhole\nintrinsics: {[*FOCAL, *CENTRE]} #fu, fv, cu, cv\n"
        f"distortion_model: radial-tangential\ndistortion_coefficients: {list(RADTAN)}\n"
    )
    return folder / "sensor.yaml"
