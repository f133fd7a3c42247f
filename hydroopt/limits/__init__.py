"""What a machine must keep: limits, the reserves that they leave, and what of them a motion uses or breaks."""
