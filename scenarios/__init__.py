"""Scenarios and campaigns: their files, the walks recorded from them, and checks of recordings."""
