"""Parts that a rig is made of: one YAML file a part with the figures of its data sheet, and what reads them."""
