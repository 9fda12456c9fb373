"""The judge of walking is physics: MuJoCo, with the URDF that we write."""
