"""Campaigns: many varied walks from one file, recorded, checked, listed in a manifest and described in a card."""
