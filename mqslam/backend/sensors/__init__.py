"""What other sensors say, held against the radar's motions before it joins the pose graph."""
