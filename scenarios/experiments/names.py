"""What experiments there are; apart from the registry, so that they can be listed without the simulator."""

EXPERIMENT_NAMES = {
    "jao_simulation": "Jao et al. 2020, Table I: a hundred identical strides north",
    "jao_straight_53m": "Jao et al. 2020, Table II: 53 m straight on the simulated walker, shoe cameras rendered",
    "jao_loop_126m": "Jao et al. 2020, Table III: 126 m loop on the simulated walker, shoe cameras rendered",
    "stairs_16": "sixteen risers up and down on the simulated walker, shoe cameras rendered",
    "jao_faults": "what the filter of two feet makes of faults: cameras, IMUs, clock, mounts, exchanged shoes",
    "zhao_closed_loop": "Zhao et al. 2023, Table V: a loop of 60 m with stairs, fifteen subjects, on head and chest",
    "zhao_closed_loop_stress": "the same loop with plain walls, blur, heel strikes, clock and mount off",
    "zhao_generality": "Zhao et al. 2023, Tables II and III: modes of coming steps over 540 walks, poses by odometry",
    "zhao_generality_given_poses": "the same walks with their true poses",
    "zhao_generality_shallow": "the same walks with the camera 8 degrees down instead of 25",
    "zhao_baselines": "sixty of the same walks, and what our prediction tells without a map, from single pictures",
    "zhao_view": "Zhao et al. 2023, Fig. 3a: between walls and round a corner, with a head that looks about widely",
    "zhao_directions": "Zhao et al. 2023, Fig. 3b: outdoors from stair to ramp to stair side by side",
    "zhao_disturbance": "Zhao et al. 2023, Fig. 3c: a stair while two people walk around the walker",
    "mode_not_fooled": "what looks like a stair or a ramp and is none: paint, shadow, kerb, table, wall, legs, mirror",
    "mode_faults": "what the prediction of modes makes of faults: odometry lost, no depth, a dead insole, a bad view",
    "dvio_bench": "Zhao et al. 2023, Table IV: ten walks as difficult as the sequences of EuRoC, and the ablation",
    "dvio_faults": "what the visual-inertial odometry makes of faults: depth, camera, IMU, passers-by, calibration",
    "shim_table5": "Shim et al. 2019, Table 5: slope and step height from the legs of seven subjects",
    "shim_faults": "what contact terrain makes of faults: insoles, encoders, AHRS, wrong lengths, shuffling, modules",
}
