"""Parts of the node `navigator` that have ROS in them, one file each."""
