"""What happens between the light and the grey levels: each part with its block, as functions of
arrays; `chain` has their order.
"""
