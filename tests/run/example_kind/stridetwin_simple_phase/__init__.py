"""Gait phase of one leg: 0 % at the touch-down of its foot, 100 % at the next one."""
