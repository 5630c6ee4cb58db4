"""What bags and MCAP files share: chunks, and one pass over them."""
