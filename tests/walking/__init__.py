"""The judge of walking is physics: MuJoCo, with the URDF that we write and the frames that a real gateway wrote."""
