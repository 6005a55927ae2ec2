"""What experiments there are; apart from the registry, so that they can be listed without the simulator."""

EXPERIMENT_NAMES = {
    "jao_simulation": "Jao et al. 2020, Table I: a hundred identical strides north",
    "jao_straight_53m": "Jao et al. 2020, Table II: 53 m straight on the simulated walker, shoe cameras rendered",
    "jao_loop_126m": "Jao et al. 2020, Table III: 126 m loop on the simulated walker, shoe cameras rendered",
    "stairs_16": "sixteen risers up and down on the simulated walker, shoe cameras rendered",
    "jao_faults": "what the filter of two feet makes of faults: cameras, IMUs, clock, mounts, exchanged shoes",
    "shim_table5": "Shim et al. 2019, Table 5: slope and step height from the legs of seven subjects",
}
