"""What happens between the exposure and the motor: shutter plan, clocks and stamps, links, latency,
setpoints.
"""
