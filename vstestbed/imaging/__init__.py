"""What happens between the light and the grey levels: optics, exposure, shutter, flicker, sensor, stream, depth."""
