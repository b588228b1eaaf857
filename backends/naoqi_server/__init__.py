"""A stand-in NAOqi: a simulated Pepper in real time behind the real qi protocol."""
