"""Recorded people: markers or joint angles of a real walk become a motion that the twin can play."""
