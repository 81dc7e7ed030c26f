"""The daemon in one word (NAMUR NE 107), from the checks of its parts, and the alarms made of them."""
