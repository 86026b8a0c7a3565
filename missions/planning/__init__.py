"""Task plans of missions: domains made of declared actions, plans asked for by hand, plans as trees and pictures."""
