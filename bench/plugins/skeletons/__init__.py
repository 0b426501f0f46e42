"""What `stepbench new` writes: a scene and an integrator that run at once, to be changed."""
