"""Plans of missions that are asked for by hand, and plans as trees."""
