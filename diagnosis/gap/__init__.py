"""Is there a gap, and where: scene by scene, by region, by spatial kind and by stage."""
