"""The whole chain, read off pictures of the paper's LED panel."""
