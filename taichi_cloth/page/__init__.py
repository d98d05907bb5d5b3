"""What a web page of a cloth is made of: its arrays, its light, and the script that draws them (`drawing.js`)."""
