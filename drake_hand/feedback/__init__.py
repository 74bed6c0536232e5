"""Object feedback during a plan: pose sensors and the correction of commands. Numpy only, no Drake."""
