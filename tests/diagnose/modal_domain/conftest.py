"""What tests of several rooms share (``chains_off``, ``frames``, ``kinds``) is found from all of them."""
