(define (domain delivery)
  (:requirements :typing :action-costs :numeric-fluents)
  (:types vehicle parcel - thing  thing  place - object)
  (:predicates (at ?t - thing ?p - place) (in ?p - parcel ?v - vehicle) (road ?a ?b - place))
  (:functions (total-cost) - number (length ?a ?b - place) - number (capacity ?v - vehicle) (weight ?p - parcel) - number)
  (:action drive
    :parameters (?v - vehicle ?a ?b - place)
    :precondition (and (at ?v ?a) (road ?a ?b))
    :effect (and (not (at ?v ?a)) (at ?v ?b) (increase (total-cost) (length ?a ?b))))
  (:action load
    :parameters (?p - parcel ?v - vehicle ?a - place)
    :precondition (and (at ?v ?a) (at ?p ?a))
    :effect (and (not (at ?p ?a)) (in ?p ?v) (increase (total-cost) 1)))
  (:action unload
    :parameters (?p - parcel ?v - vehicle ?a - place)
    :precondition (and (at ?v ?a) (in ?p ?v))
    :effect (and (at ?p ?a) (not (in ?p ?v)) (increase (total-cost) 1))))
