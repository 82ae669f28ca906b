"""The live view: a session, or a recorded run, in a browser, with its settings under your fingers
(`vstestbed live`).
"""
