"""Parts of scenes: bodies, joints, rotations, and drawing."""
