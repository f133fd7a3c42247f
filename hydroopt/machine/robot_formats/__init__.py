"""Robot formats: URDF and MJCF to machine files, machines to URDF, MJCF and SDF."""
