"""The object seen while a plan is played: sensors, and the correction of what they see. Numpy only, no Drake."""
