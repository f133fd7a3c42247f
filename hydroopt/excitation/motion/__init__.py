"""The motion to drive next."""
