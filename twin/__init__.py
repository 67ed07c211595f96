"""Physics-based digital twin of camera-based tactile sensors."""
